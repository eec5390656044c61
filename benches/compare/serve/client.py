"""Clients that cost little: HTTP by hand over asyncio's streams, on connections that are kept."""

import asyncio
import time
from dataclasses import dataclass, field

LIMIT_S = 60.0
"""What takes longer has no answer."""


@dataclass
class Load:
    """What a load did. Times are milliseconds."""

    elapsed_s: float = 0.0
    answered: list = field(default_factory=list)
    refused: list = field(default_factory=list)
    others: int = 0

    @property
    def rate(self):
        return len(self.answered) / self.elapsed_s

    def book(self, status, milliseconds):
        if status == 200:
            self.answered.append(milliseconds)
        elif status in (429, 503):
            self.refused.append(milliseconds)
        else:
            self.others += 1


class Connection:
    def __init__(self, port):
        self.port, self.reader, self.writer = port, None, None

    async def post(self, message):
        """The status and the body of the answer."""
        try:
            async with asyncio.timeout(LIMIT_S):
                if self.writer is None or self.reader.at_eof():
                    self.close()
                    self.reader, self.writer = await asyncio.open_connection("127.0.0.1", self.port)
                self.writer.write(message)
                head = (await self.reader.readuntil(b"\r\n\r\n")).lower()
                length = head.split(b"\r\ncontent-length:")[1].split(b"\r\n")[0]
                body = await self.reader.readexactly(int(length))
                if b"connection: close" in head:
                    self.close()
                return int(head.split(b" ")[1]), body
        except (OSError, asyncio.IncompleteReadError, TimeoutError, IndexError):
            self.close()
            return 0, b""

    def close(self):
        if self.writer is not None:
            self.writer.close()
            self.writer = None


async def timed(connection, message, load):
    start = time.perf_counter()
    status, _ = await connection.post(message)
    load.book(status, 1e3 * (time.perf_counter() - start))
    return status


async def closed(port, message, clients, seconds):
    """So many clients that each wait for their answer; whoever is refused waits a little."""
    load, start = Load(), time.perf_counter()

    async def one():
        connection = Connection(port)
        while time.perf_counter() - start < seconds:
            if await timed(connection, message, load) != 200:
                await asyncio.sleep(0.05)
        connection.close()

    await asyncio.gather(*(one() for _ in range(clients)))
    load.elapsed_s = time.perf_counter() - start
    return load


async def opened(port, message, rate, seconds):
    """Requests at fixed times, whatever becomes of them. Answers after the end are waited for, and counted."""
    load, start, idle, tasks = Load(), time.perf_counter(), [], []

    async def one():
        connection = idle.pop() if idle else Connection(port)
        await timed(connection, message, load)
        idle.append(connection)

    for number in range(int(rate * seconds)):
        await asyncio.sleep(max(0.0, start + number / rate - time.perf_counter()))
        tasks.append(asyncio.create_task(one()))
    await asyncio.gather(*tasks)
    load.elapsed_s = time.perf_counter() - start
    for connection in idle:
        connection.close()
    return load


async def once(port, message):
    connection = Connection(port)
    answer = await connection.post(message)
    connection.close()
    return answer
