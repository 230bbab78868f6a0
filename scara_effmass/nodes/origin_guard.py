# SPDX-License-Identifier: Apache-2.0
"""TCP server in front of a WebSocket server that does not look at the origin of its clients."""

import asyncio
import socket
import threading
from contextlib import suppress
from typing import final
from urllib.parse import urlsplit

HEAD_TIMEOUT_S = 10.0
"""Time for which a connection may be open without a complete request."""
MAX_CONNECTIONS = 100
_MAX_HEAD = 16_384
_CHUNK = 65_536
_LOCAL_NAMES = {"localhost", "127.0.0.1", "::1"}
_WEB = {"http", "https"}


def is_trusted(head: bytes, sites: tuple[str, ...]) -> bool:
    """Return whether a request with this `head` comes from no page of a site but this machine's, `sites` or theirs.

    Programs state no origin, desktop applications one of their own scheme. Raises ValueError for a malformed one.
    """
    lines = head.decode("latin-1").split("\r\n")[1:]
    origins = [text.strip() for name, _, text in (line.partition(":") for line in lines) if name.lower() == "origin"]
    if len(origins) > 1:
        raise ValueError("two origins")
    if not origins:
        return True
    url = urlsplit(origins[0])
    if url.port is not None and not url.hostname:
        raise ValueError("a port without a host")
    if url.scheme not in _WEB:
        return bool(url.scheme)  # "null" is any sandboxed page
    host = url.hostname or ""
    return host in _LOCAL_NAMES or any(host == site or host.endswith(f".{site}") for site in sites)


@final
class OriginGuard:
    """Passes connections of trusted origins on to a port of this machine, in a thread. Use it in a `with`."""

    def __init__(self, listener: socket.socket, port: int, sites: tuple[str, ...]) -> None:
        """Accept at `listener`, pass on to `port` of 127.0.0.1; pages of `sites` are trusted besides those of here."""
        self._listener, self._port, self._sites = listener, port, sites
        self._count = 0
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._run, name="origin guard", daemon=True)

    def __enter__(self) -> None:
        self._thread.start()

    def __exit__(self, *_: object) -> None:
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()

    def _run(self) -> None:
        server = self._loop.run_until_complete(self._start())
        self._loop.run_forever()
        server.close()
        self._loop.run_until_complete(self._end())
        self._loop.close()

    async def _start(self) -> asyncio.Server:
        return await asyncio.start_server(self._serve, sock=self._listener, limit=_MAX_HEAD)

    async def _end(self) -> None:
        tasks = asyncio.all_tasks() - {asyncio.current_task()}
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._count += 1
        try:
            if self._count <= MAX_CONNECTIONS:
                await self._answer(reader, writer)
        except (OSError, asyncio.IncompleteReadError, asyncio.LimitOverrunError, TimeoutError, asyncio.TimeoutError):
            pass  # the client or the server behind has ended, or the request is not complete
        finally:
            self._count -= 1
            writer.close()

    async def _answer(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        head = await asyncio.wait_for(reader.readuntil(b"\r\n\r\n"), HEAD_TIMEOUT_S)
        try:
            status = b"" if is_trusted(head, self._sites) else b"403 Forbidden"
        except ValueError:
            status = b"400 Bad Request"
        if status:
            writer.write(b"HTTP/1.1 " + status + b"\r\nContent-Length: 0\r\nConnection: close\r\n\r\n")
            await writer.drain()
            return
        inner, server = await asyncio.open_connection("127.0.0.1", self._port)
        try:
            server.write(head)
            directions = [asyncio.create_task(_pass_on(*pair)) for pair in ((reader, server), (inner, writer))]
            await asyncio.wait(directions, return_when=asyncio.FIRST_COMPLETED)
            for task in directions:
                task.cancel()
        finally:
            server.close()


async def _pass_on(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    with suppress(OSError):
        while data := await reader.read(_CHUNK):
            writer.write(data)
            await writer.drain()
