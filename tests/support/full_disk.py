"""Run one command line; at every file it writes, a twin goes on with a full disk, and what the twin did is told.

    python full_disk.py FOLDER COMMAND ...        one JSON line per file in twins.jsonl beside the folder

The folder is as it was before each twin, so that one run shows a full disk at each of its files.
"""

from __future__ import annotations

import hashlib
import json
import os
import resource
import secrets
import shutil
import signal
import sys
from pathlib import Path

MOST_BYTES, TOLD = 16, "twins.jsonl"


def content(folder: Path) -> dict[str, str]:
    """Every file of a folder with the digest of its bytes."""
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def main(folder: Path, arguments: list[str]) -> int:
    """Run the command in ``folder``, and a twin per file."""
    from attest_cli.__main__ import run

    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)  # a write that is too large is then an error, as on a full disk
    os.chdir(folder)
    token, before = secrets.token_hex, content(folder)

    def forked(size: int) -> str:
        caller = sys._getframe(1)
        if caller.f_code.co_name == "atomic_write":
            here, name = folder.parent / "as-it-was", caller.f_locals["path"].name
            shutil.copytree(folder, here, symlinks=True)
            read, write = os.pipe()
            sys.stdout.flush()
            child = os.fork()
            if child == 0:
                secrets.token_hex = token
                os.dup2(write, 2)
                os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
                resource.setrlimit(resource.RLIMIT_FSIZE, (MOST_BYTES, resource.getrlimit(resource.RLIMIT_FSIZE)[1]))
                return token(size)
            os.close(write)
            with os.fdopen(read, encoding="utf-8") as words:
                said = words.read()
            code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
            same = content(folder) == before
            left = sorted(content(folder).keys() - before.keys())
            ended = {"file": name, "code": code, "said": said, "same": same, "left": left}
            with (folder.parent / TOLD).open("a", encoding="utf-8") as lines:
                lines.write(json.dumps(ended) + chr(10))
            for path in folder.iterdir():
                shutil.rmtree(path) if path.is_dir() else path.unlink()
            shutil.copytree(here, folder, symlinks=True, dirs_exist_ok=True)
            shutil.rmtree(here)
        return token(size)

    secrets.token_hex = forked
    return run([*arguments])


if __name__ == "__main__":
    code = main(Path(sys.argv[1]).resolve(), sys.argv[2:])
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)  # a twin, too, ends here
