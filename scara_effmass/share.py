"""Where the files are that come with the package: `config/`, `launch/`, `bags/`."""

from __future__ import annotations

from pathlib import Path

from scara_effmass.errors import EffmassError


def share(*parts: str) -> Path:
    """Return the path of a shipped file or folder, as in `share("config", "omron_i4_550l.yaml")`.

    In a checkout (also when installed editable, or by colcon with symlinks) that is the one in the tree,
    otherwise the one under `share/scara_effmass` of the prefix that pip or colcon installed to.
    Raises EffmassError when it is not there.
    """
    return _resolve(Path(__file__).resolve(), parts)


def _resolve(module: Path, parts: tuple[str, ...]) -> Path:
    checkout = module.parents[1]
    installed = (parent / "share" / "scara_effmass" for parent in module.parents)
    for root in (checkout, *installed):
        if (root / "package.xml").is_file():
            path = root.joinpath(*parts)
            if not path.exists():
                raise EffmassError(f"{path}: does not exist; it comes with scara_effmass, so install it again")
            return path
    raise EffmassError(f"{module}: no share/scara_effmass above it; install scara_effmass with pip or colcon")
