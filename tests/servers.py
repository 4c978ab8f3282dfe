"""A server on loopback that publishes files, in the good and bad ways servers do."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from threading import Event, Thread


@dataclass
class Published:
    """What a server has, how it answers, and what it was asked for."""

    address: str
    files: dict[str, bytes] = field(default_factory=dict, repr=False)
    breaks: list[int] = field(default_factory=list)
    """Bytes after which each next answer breaks off."""
    status: int = 200
    kind: str = "text/plain"
    says_length: bool = True
    stalls: bool = False
    """Whether a broken answer leaves the line open and says nothing more."""
    stalled: Event = field(default_factory=Event)
    asked: list[str] = field(default_factory=list, repr=False)
    """Path of each request."""
    over: Event = field(default_factory=Event)


@contextmanager
def serving() -> Iterator[Published]:
    """A server until the end of the block."""

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            answer(self, published)

        def log_message(self, *_: object) -> None:
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        published = Published(f"http://127.0.0.1:{server.server_port}")
        thread = Thread(target=server.serve_forever, args=(0.01,))
        thread.start()
        try:
            yield published
        finally:
            published.over.set()
            server.shutdown()
            thread.join()


def answer(request: BaseHTTPRequestHandler, published: Published) -> None:
    published.asked.append(request.path)
    data = published.files.get(request.path)
    if published.status != 200 or data is None:
        request.send_error(404 if data is None else published.status)
        return
    request.send_response(200)
    request.send_header("Content-Type", published.kind)
    if published.says_length:
        request.send_header("Content-Length", str(len(data)))
    request.end_headers()
    if not published.breaks:
        request.wfile.write(data)
        return
    request.wfile.write(data[: published.breaks.pop(0)])
    if published.stalls:
        published.stalled.set()
        published.over.wait()


def unused_address() -> str:
    """An address at which nothing listens."""
    with ThreadingHTTPServer(("127.0.0.1", 0), BaseHTTPRequestHandler) as server:
        return f"http://127.0.0.1:{server.server_port}"
