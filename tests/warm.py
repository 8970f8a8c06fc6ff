"""Processes that begin with torchlc and its libraries loaded, for tests of whole commands: ``python -m tests.warm ADDRESS``
loads them once and forks for each request, which saves 2 to 5 CPU s a process.

A request is a command line with its folder, its environment and its three streams; the answer is the exit code. How
a process starts that has nothing loaded, and what it loads, is for the tests of the command line and of imports.
Workers of a campaign are forked too; those that start with nothing loaded are for the tests of campaigns.
"""

from __future__ import annotations

import contextlib
import json
import os
import resource
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parent.parent
LOADED = (
    "torch",
    "torchlc.api",
    "torchlc.cli.program",
    "torchlc.inference.sampler",
    "torchlc.report.fit_page",
    "torchlc.diagnosis.run",
    "arviz",
    "emcee",
    "matplotlib.pyplot",
    "pandas",
    "scipy.stats",
    "PIL.Image",
    "h5py",
)
PATIENCE_S = 120.0
LENGTH = 8
"""Bytes that say how long a request is."""
SHIM = """#!{python} -IS
import sys
sys.path.insert(0, {root!r})
from tests.warm import call
sys.exit(call({address!r}, ["torchlc", *sys.argv[1:]]))
"""


def call(
    address: str,
    command: list[str],
    *,
    cwd: Path | str | None = None,
    env: dict[str, str] | None = None,
    streams: tuple[int, int, int] = (0, 1, 2),
    most_bytes: int | None = None,
) -> int:
    """Run ``command``, which begins with ``torchlc``, ``page`` or ``killed`` (the arguments of a page, and of ``tests.killed_runs``),
    and return its exit code. No file that it writes grows beyond ``most_bytes``, as on a disk that is full."""
    content = {
        "command": command,
        "most_bytes": most_bytes,
        "cwd": str(cwd or Path.cwd()),
        "env": dict(os.environ) if env is None else env,
    }
    request = json.dumps(content).encode()
    with socket.socket(socket.AF_UNIX) as link:
        link.connect(address)
        socket.send_fds(link, [len(request).to_bytes(LENGTH, "big")], streams)
        link.sendall(request)
        answer = link.recv(1)
    if not answer:
        raise ConnectionError("the process ended without an answer")
    return answer[0]


@contextlib.contextmanager
def server(folder: Path) -> Iterator[tuple[str, Path]]:
    """The address of a server, and a folder for PATH in which ``torchlc`` asks it."""
    address, programs = str(folder / "socket"), folder / "bin"
    programs.mkdir()
    shim = programs / "torchlc"
    shim.write_text(SHIM.format(python=sys.executable, root=str(ROOT), address=address))
    shim.chmod(0o755)
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "MPLBACKEND": "agg"}
    process = subprocess.Popen([sys.executable, "-m", "tests.warm", address], cwd=folder, env=environment)
    try:
        until = time.monotonic() + PATIENCE_S
        while not Path(address).exists():
            assert process.poll() is None and time.monotonic() < until, "no server of processes"
            time.sleep(0.05)
        yield address, programs
    finally:
        process.terminate()
        process.wait()


def serve(address: str) -> None:
    """Answer requests for ever. Returns in a process that is to run a command."""
    import importlib

    for name in LOADED:
        importlib.import_module(name)
    from torchlc.campaigns import processes

    processes.START_METHOD = "fork"
    signal.signal(signal.SIGCHLD, _reap)
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind(address + ".new")
        listening.listen()
        Path(address + ".new").rename(address)
        while True:
            link, _ = listening.accept()
            with link:
                if os.fork():
                    continue
                signal.signal(signal.SIGCHLD, signal.SIG_DFL)
                head, streams, _, _ = socket.recv_fds(link, LENGTH, 3)
                content = json.loads(_received(link, int.from_bytes(head, "big")))
                if child := os.fork():
                    status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
                    link.sendall(bytes([status if status >= 0 else 128 - status]))
                    os._exit(0)
            for number, stream in enumerate(streams):
                os.dup2(stream, number)
                os.close(stream)
            sys.stdin = os.fdopen(0, closefd=False)  # those of the server know what their files could do
            sys.stdout = os.fdopen(1, "w", closefd=False)
            sys.stderr = os.fdopen(2, "w", errors="backslashreplace", buffering=1, closefd=False)
            os.chdir(content["cwd"])
            os.environ.clear()
            os.environ.update(content["env"])
            if content["most_bytes"] is not None:
                resource.setrlimit(resource.RLIMIT_FSIZE, (content["most_bytes"],) * 2)
            sys.argv = content["command"]
            return


def said(address: str, command: list[str], **options: Any) -> tuple[int, str, str]:
    """As ``call``; with what was written to standard output and standard error."""
    with (
        tempfile.TemporaryFile() as out,
        tempfile.TemporaryFile() as err,
        Path(os.devnull).open("rb") as nothing,
    ):
        code = call(address, command, streams=(nothing.fileno(), out.fileno(), err.fileno()), **options)
        texts = []
        for stream in (out, err):
            stream.seek(0)
            texts.append(stream.read().decode())
    return code, texts[0], texts[1]


def _reap(*_: object) -> None:
    """Wait for those that have answered, so that their CPU time counts as this process's children's."""
    with contextlib.suppress(ChildProcessError):
        while os.waitpid(-1, os.WNOHANG)[0]:
            pass


def _received(link: socket.socket, length: int) -> bytes:
    content = b""
    while len(content) < length:
        content += link.recv(length - len(content))
    return content


if __name__ == "__main__":
    serve(sys.argv[1])
    if sys.argv[0] == "page":
        from tests.run_page import run

        sys.path[0] = ""  # as of ``python -m``
        run(Path(sys.argv[1]))
    elif sys.argv[0] == "killed":
        from tests.killed_runs import main as kill

        kill(Path(sys.argv[1]), int(sys.argv[2]), sys.argv[3:])
    else:
        from torchlc.cli import main

        main()
