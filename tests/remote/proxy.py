"""A proxy between the program and an S3 server that counts requests and injects faults."""

from __future__ import annotations

import http.client
import threading
import time
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Callable


@dataclass
class Request:
    method: str
    path: str
    range: str
    length: int


@dataclass
class Faults:
    """What goes wrong. Faults depend on the number of the request, so that tests are repeatable."""

    #: Seconds before each answer.
    delay: float = 0.0
    #: Every n-th request is answered by 503; 0 for none.
    unavailable: int = 0
    #: The answer to every n-th request, if it is a GET, is cut in the middle; 0 for none.
    cut: int = 0
    #: The answer to every n-th request, if it is a write, is lost after the write took place; 0 for none.
    lost: int = 0
    #: Whether the answer to this request is cut, too.
    cuts: Callable[[Request], bool] = lambda request: False
    #: Status of refused requests; 0 passes a request on.
    refused: Callable[[Request], int] = lambda request: 0
    #: Called before a request is passed on.
    before: Callable[[Request], None] = lambda request: None


@dataclass
class Proxy:
    """Passes requests on to a server. Conditional writes are passed on one at a time, because this server checks and
    writes in two steps, and S3 in one."""

    host: str
    port: int
    faults: Faults = field(default_factory=Faults)
    requests: list[Request] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.count = 0
        self.lock = threading.Lock()
        self.pending = 0
        self.idle = threading.Condition()
        self.conditional = threading.Lock()
        proxy = self

        class Handler(BaseHTTPRequestHandler):
            protocol_version = "HTTP/1.1"

            def log_message(self, *_: object) -> None:
                pass

            def answer(self) -> None:
                with proxy.idle:
                    proxy.pending += 1
                try:
                    proxy.answer(self)
                finally:
                    with proxy.idle:
                        proxy.pending -= 1
                        proxy.idle.notify_all()

            do_GET = do_PUT = do_HEAD = do_POST = do_DELETE = answer

        class Server(ThreadingHTTPServer):
            daemon_threads = True
            request_queue_size = 128

            def handle_error(self, *_: object) -> None:
                """Ignores errors of connections that the program closed."""

        self.server = Server(("127.0.0.1", 0), Handler)
        threading.Thread(target=self.server.serve_forever, daemon=True).start()

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.server.server_port}"

    def reset(self, faults: Faults | None = None) -> None:
        with self.lock:
            self.faults = faults or Faults()
            self.requests = []
            self.count = 0

    def wait_until_idle(self) -> None:
        """Waits until all requests are answered, also those of a client that is gone."""
        with self.idle:
            assert self.idle.wait_for(lambda: self.pending == 0, timeout=60)

    def reads(self, part: str) -> list[Request]:
        return [request for request in self.requests if request.method == "GET" and part in request.path]

    def answer(self, handler: BaseHTTPRequestHandler) -> None:
        length = int(handler.headers.get("Content-Length") or 0)
        body = handler.rfile.read(length)
        request = Request(handler.command, handler.path, handler.headers.get("Range", ""), length)
        with self.lock:
            self.requests.append(request)
            self.count += 1
            number, faults = self.count, self.faults
        faults.before(request)
        if faults.delay:
            time.sleep(faults.delay)
        status = faults.refused(request)
        if not status and faults.unavailable and number % faults.unavailable == 0:
            status = 503
        if status:
            return self.send(handler, status, [], b"<Error><Code>Injected</Code></Error>")
        if handler.headers.get("If-None-Match"):
            with self.conditional:
                status, headers, content = self.forward(handler, body)
        else:
            status, headers, content = self.forward(handler, body)
        writes = handler.command in ("PUT", "POST", "DELETE")
        if writes and faults.lost and number % faults.lost == 0:
            handler.close_connection = True
            return handler.connection.close()
        by_number = faults.cut and number % faults.cut == 0
        cut = handler.command == "GET" and len(content) > 1 and (by_number or faults.cuts(request))
        self.send(handler, status, headers, content, cut=bool(cut))

    def forward(self, handler: BaseHTTPRequestHandler, body: bytes) -> tuple[int, list[tuple[str, str]], bytes]:
        connection = http.client.HTTPConnection(self.host, self.port, timeout=60)
        headers = {name: value for name, value in handler.headers.items() if name.lower() != "connection"}
        connection.request(handler.command, handler.path, body, headers)
        answer = connection.getresponse()
        content = answer.read()
        dropped = ("connection", "transfer-encoding", "content-length", "server", "date")
        kept = [(name, value) for name, value in answer.getheaders() if name.lower() not in dropped]
        if handler.command == "HEAD":
            kept.append(("Content-Length", answer.getheader("Content-Length") or "0"))
        connection.close()
        return answer.status, kept, content

    def send(
        self, handler: BaseHTTPRequestHandler, status: int, headers: list[tuple[str, str]], content: bytes, cut: bool = False
    ) -> None:
        handler.send_response(status)
        for name, value in headers:
            handler.send_header(name, value)
        if not any(name.lower() == "content-length" for name, _ in headers):
            handler.send_header("Content-Length", str(len(content)))
        handler.end_headers()
        # The answer to a HEAD must have no body: a client would take the body for the answer to its next request.
        if handler.command != "HEAD":
            handler.wfile.write(content[: len(content) // 2] if cut else content)
        if cut:
            handler.wfile.flush()
            handler.close_connection = True
