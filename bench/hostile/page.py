"""The live page: idle sockets, long paths, odd messages."""

import asyncio
import contextlib
import http.client
import json
import os
import resource
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import urlsplit

from bench.hostile.attack import Attack, Outcome

_TOKEN = "0123456789abcdef0123456789abcdef"
_DESCRIPTORS = 1024  # the soft limit of a process on Linux
_LOG_BYTES = 20_000  # a minute of eight conditions, each named at most every 10 s
_SECONDS = 30.0  # longest wait for an answer of a page that is not served at all


@dataclass(frozen=True)
class _Page:
    """A running ``tactiled web``."""

    host: str
    port: int
    log: Path
    pid: int

    def connect(self) -> socket.socket:
        return socket.create_connection((self.host, self.port), timeout=_SECONDS)

    def ask(self, method: str, path: str, body: bytes = b"") -> tuple[int, bytes]:
        connection = http.client.HTTPConnection(self.host, self.port, timeout=_SECONDS)
        headers = {"Authorization": f"Bearer {_TOKEN}", "Content-Type": "application/json"}
        try:
            connection.request(method, path, body or None, headers)
            answer = connection.getresponse()
            return answer.status, answer.read()
        finally:
            connection.close()

    def logged(self) -> str:
        return self.log.read_text(errors="replace")

    def descriptors(self) -> int:
        return len(os.listdir(f"/proc/{self.pid}/fd"))  # noqa: PTH208  names only


@contextlib.contextmanager
def _page(folder: Path, descriptors: int = _DESCRIPTORS) -> Iterator[_Page]:
    log, token = folder / "log", folder / "token"
    token.write_text(_TOKEN)
    token.chmod(0o600)
    words = [
        sys.executable, "-m", "tactiled", "web", "--port", "0", "--events", f"ipc://{folder}/events.ipc",
        "--allow-commands", "--token-file", str(token),
    ]  # fmt: skip
    limited = ["prlimit", f"--nofile={descriptors}:{descriptors}", *words]
    with log.open("w") as stderr:
        process = subprocess.Popen(limited, stdout=subprocess.PIPE, stderr=stderr, text=True)
    try:
        assert process.stdout is not None
        line = process.stdout.readline()
        if not line:
            raise RuntimeError(f"the page did not start: {log.read_text()}")
        parts = urlsplit(json.loads(line)["url"])
        yield _Page(str(parts.hostname), int(parts.port or 0), log, process.pid)
    finally:
        process.terminate()
        process.wait()
        assert process.stdout is not None
        process.stdout.close()


def _idle(folder: Path, scale: float) -> Outcome:
    """Hold 1,100 connections open without a request, and ask for the page meanwhile."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (min(4096, hard), hard))
    try:
        with _page(folder) as page, contextlib.ExitStack() as stack:
            for _ in range(1100):
                stack.enter_context(page.connect())
            answers = [page.ask("GET", "/")[0] for _ in range(5)]
            most = page.descriptors()
            until_s = time.monotonic() + 92.0 * scale
            while time.monotonic() < until_s:
                answers.append(page.ask("GET", "/api/session")[0])
                time.sleep(1.0)
            logged = page.logged()
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
    held = set(answers) == {200} and len(logged) < _LOG_BYTES and "Traceback" not in logged
    served = f"{answers.count(200)} of {len(answers)} requests answered"
    return Outcome(f"{served}, {most} descriptors, {len(logged)} bytes of log", held)


def _descriptors(folder: Path, scale: float) -> Outcome:  # noqa: ARG001  one size
    """Take the last descriptor of a page that has 60, and leave again."""
    with _page(folder, descriptors=60) as page:
        with contextlib.ExitStack() as stack:
            for _ in range(110):
                stack.enter_context(page.connect())
            time.sleep(3.0)  # accepts fail all the while
        status, _ = page.ask("GET", "/")
        logged = page.logged()
    held = status == 200 and len(logged) < _LOG_BYTES and "Traceback" not in logged
    return Outcome(f"{status} afterwards, {len(logged)} bytes of log", held)


def _paths(folder: Path, scale: float) -> Outcome:  # noqa: ARG001
    names = [
        "a" * 300,
        "a" * 5000,
        "..%2f..%2fserver.py",
        "%2e%2e/server.py",
        "/etc/passwd",
        "%00",
        "%ff%fe",
        "",
    ]
    with _page(folder) as page:
        found = [page.ask("GET", f"/static/{name}")[0] for name in names]
        logged = page.logged()
    held = set(found) == {404} and "Traceback" not in logged
    return Outcome(f"status {sorted(set(found))}, {len(logged)} bytes of log", held)


def _numbers(folder: Path, scale: float) -> Outcome:  # noqa: ARG001
    values = [str(2**64), str(-(2**63) - 1), "9" * 5000, "[" * 5000 + "]" * 5000, '"\\ud800"']
    found = []
    with _page(folder) as page:
        for value in values:
            body = '{"do":"thresholds","fields":{"values":{"x":' + value + "}}}"
            status, answer = page.ask("POST", "/api/command", body.encode())
            found.append(status in (200, 400) and json.loads(answer)["ok"] is False)
        logged = page.logged()
    refused = f"{sum(found)} of {len(found)} refused with a reason, {len(logged)} bytes of log"
    return Outcome(refused, all(found) and "Traceback" not in logged)


def _garbage(folder: Path, scale: float) -> Outcome:
    """Requests that are no HTTP, each of which the library would log with a traceback."""
    tried = max(1, round(5000 * scale))
    heads = [
        b"GET / HTTP/9.x\r\n\r\n",
        b"\x16\x03\x01\x02\x00\x01\r\n\r\n",
        b"GET / HTTP/1.1\r\nA\x00: b\r\n\r\n",
    ]

    async def send(page: _Page, number: int) -> None:
        reader, writer = await asyncio.open_connection(page.host, page.port)
        with contextlib.suppress(ConnectionError):
            writer.write(heads[number % len(heads)])
            await reader.read()
        writer.close()

    async def all_of(page: _Page) -> None:
        for first in range(0, tried, 50):
            await asyncio.gather(*(send(page, n) for n in range(first, min(first + 50, tried))))

    with _page(folder) as page:
        asyncio.run(all_of(page))
        status, _ = page.ask("GET", "/")
        logged = page.logged()
    held = status == 200 and len(logged) < _LOG_BYTES and "Traceback" not in logged
    return Outcome(f"{status} afterwards, {len(logged)} bytes of log after {tried} requests", held)


def _deaf(folder: Path, scale: float) -> Outcome:  # noqa: ARG001
    """Ask for the largest file again and again on connections that read nothing."""
    with _page(folder) as page, contextlib.ExitStack() as stack:
        for _ in range(300):
            sock = stack.enter_context(page.connect())
            sock.sendall(b"GET /static/uplot/uPlot.esm.js HTTP/1.1\r\nHost: localhost\r\n\r\n" * 40)
        status, _ = page.ask("GET", "/")
        with Path(f"/proc/{page.pid}/status").open() as lines:
            (resident,) = (int(line.split()[1]) for line in lines if line.startswith("VmRSS"))
    return Outcome(f"{status} meanwhile, {resident // 1024} MB", status == 200 and resident < 200 * 1024)


def _token(folder: Path, scale: float) -> Outcome:  # noqa: ARG001
    token = folder / "token"
    token.write_text(_TOKEN)
    token.chmod(0o644)
    words = ["web", "--port", "0", "--events", f"ipc://{folder}/events.ipc", "--allow-commands"]
    program = [sys.executable, "-m", "tactiled", *words, "--token-file", str(token)]
    # With a limit, because a page that accepts the file does not end.
    done = subprocess.run(program, capture_output=True, text=True, timeout=_SECONDS, check=False)
    held = done.returncode == 2 and "chmod 600" in done.stderr and "Traceback" not in done.stderr
    return Outcome(f"exit code {done.returncode}: {done.stderr.strip().rpartition(': ')[2][:9]}", held)


ATTACKS: tuple[Attack, ...] = (
    Attack(
        "page: idle connections",
        "1,100 connections held for 92 s without a request",
        "every request answered, less than 20 kB of log",
        _idle,
        short=0.02,
    ),
    Attack(
        "page: no descriptors",
        "110 connections to a page that may have 60 descriptors",
        "less than 20 kB of log, answers afterwards",
        _descriptors,
        short=None,
    ),
    Attack("page: paths", "8 names below /static, long ones and ways out of it", "404 each", _paths),
    Attack("page: numbers", "5 values that no message can hold", "refused with a reason", _numbers),
    Attack(
        "page: no HTTP", "5,000 requests that are no HTTP", "less than 20 kB of log", _garbage, short=None
    ),
    Attack(
        "page: deaf readers",
        "300 connections that ask for 40 files of 145 kB and read nothing",
        "answers meanwhile, below 200 MB",
        _deaf,
        short=None,
    ),
    Attack("page: token file", "a token file of mode 644", "exit code 2 with what to do", _token),
)
