# SPDX-License-Identifier: Apache-2.0
"""Location of the files shipped with the package: `config/`, `launch/`, `bags/`."""

from pathlib import Path

from scara_effmass.errors import EffmassError


def share(*parts: str, module: Path = Path(__file__)) -> Path:
    """Return the path of a shipped file or folder, for example `share("config", "omron_i4_550l.yaml")`.

    A checkout, an editable installation and a colcon build with symlinks use the files of the source tree, any other
    installation those in `share/scara_effmass` of its prefix. The search starts at `module`. Raises EffmassError if
    the file is missing.
    """
    module = module.resolve()
    checkout = module.parents[1]
    installed = (parent / "share" / "scara_effmass" for parent in module.parents)
    for root in (checkout, *installed):
        if (root / "package.xml").is_file():
            path = root.joinpath(*parts)
            if not path.exists():
                raise EffmassError(f"{path}: does not exist; install scara_effmass again")
            return path
    raise EffmassError(f"{module}: no share/scara_effmass above it; install scara_effmass with pip or colcon")
