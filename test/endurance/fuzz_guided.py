# SPDX-License-Identifier: Apache-2.0
"""Coverage-guided fuzzing of the file parsers: `python test/endurance/fuzz_guided.py [--seconds 60] [PARSER ...]`.

Needs atheris (`pip install atheris`). A finding is an exception other than EffmassError, 20 s for one file, or 2 GB of
memory; its file is kept in build/. Exit status 1 with a finding. Each parser has a process, which libFuzzer ends.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

try:
    import atheris
except ImportError:
    sys.exit("fuzz_guided: atheris must be installed: pip install atheris")

ROOT = Path(__file__).resolve().parents[2]
CHILD = "SCARA_EFFMASS_FUZZED"
INSTRUMENTED = ["scara_effmass", "mcap", "nptdms", "rosbags", "yaml"]
# Atheris instruments sources on the path, not what the finder of the editable installation loads.
sys.meta_path[:] = [finder for finder in sys.meta_path if "Scikit" not in type(finder).__name__]
sys.path.insert(0, str(ROOT))
with atheris.instrument_imports(include=INSTRUMENTED) if CHILD in os.environ else contextlib.nullcontext():
    import fuzz

    from scara_effmass.errors import EffmassError


def main() -> int:
    """Fuzz the parsers one after the other."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("parsers", nargs="*", help="default: all")
    options.add_argument("--seconds", type=int, default=60, help="for each parser")
    options.add_argument("--seed", type=int, default=1)
    args = options.parse_args()
    if CHILD in os.environ:
        guided(args.parsers[0], args.seconds, args.seed)
    with TemporaryDirectory() as folder:
        names = args.parsers or list(fuzz.parsers(Path(folder)))
    failed = []
    for name in names:
        command = [sys.executable, __file__, "--seconds", str(args.seconds), "--seed", str(args.seed), name]
        ended = subprocess.run(command, env={**os.environ, CHILD: "1"}, stderr=subprocess.PIPE, text=True, check=False)
        last = [line for line in ended.stderr.splitlines() if "cov:" in line][-1:]
        fuzz.show(f"{name}: {last[0].partition(' exec/s')[0] if last else ''} exit status {ended.returncode}")
        if ended.returncode:
            failed.append(name)
            fuzz.show(ended.stderr[-3000:])
    fuzz.show(f"{len(failed)} findings")
    return bool(failed)


def guided(name: str, seconds: int, seed: int) -> None:
    """Fuzz the parser `name`, and end the process."""
    with TemporaryDirectory() as folder:
        file, content, read = fuzz.parsers(Path(folder))[name]
        corpus, path = Path(folder, "corpus"), Path(folder, f"x{file}")
        corpus.mkdir()
        (corpus / "valid").write_bytes(content)
        dictionary = Path(folder, "snippets")
        dictionary.write_text("".join(f'"{_escaped(text)}"\n' for text in fuzz.SNIPPETS), encoding="ascii")
        kept = ROOT / "build" / f"fuzz_{name.replace(' ', '_')}_"
        kept.parent.mkdir(exist_ok=True)

        def one(data: bytes) -> None:
            path.write_bytes(data)
            with contextlib.suppress(EffmassError), contextlib.redirect_stdout(None):
                read(path)

        with atheris.instrument_imports(include=INSTRUMENTED):
            one(content)  # imports what it needs
        limits = [f"-max_total_time={seconds}", f"-seed={seed}", "-timeout=20", "-rss_limit_mb=2048"]
        limits += [f"-max_len={2 * len(content)}", f"-dict={dictionary}", f"-artifact_prefix={kept}"]
        atheris.Setup([sys.argv[0], *limits, str(corpus)], one)
        atheris.Fuzz()


def _escaped(text: bytes) -> str:
    return "".join(f"\\x{byte:02x}" for byte in text[:60])


if __name__ == "__main__":
    sys.exit(main())
