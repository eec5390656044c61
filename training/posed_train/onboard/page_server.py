"""Serves the page of `posed-train label` to the browser on this machine."""

import json
import re
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.parse import urlsplit

from ..bop import DatasetError
from .page_state import State

ADDRESS = "127.0.0.1"
FILES = Path(__file__).parent / "page"
TYPES = {".html": "text/html", ".js": "text/javascript", ".css": "text/css", ".svg": "image/svg+xml"}
IMAGE = re.compile(r"/image/([\w-]+)/(\d+)(/small)?")
MOST_BYTES = 4 << 20
POLICY = "default-src 'self'; img-src 'self' data: blob:; frame-ancestors 'none'; base-uri 'none'; form-action 'none'"


class Server(ThreadingHTTPServer):
    daemon_threads = True

    def __init__(self, state: State, port: int):
        super().__init__((ADDRESS, port), Handler)
        self.state = state
        self.hosts = {f"{name}:{self.server_port}" for name in (ADDRESS, "localhost")}

    @property
    def url(self) -> str:
        return f"http://{ADDRESS}:{self.server_port}/"


class Handler(BaseHTTPRequestHandler):
    server: Server
    protocol_version = "HTTP/1.1"

    def do_GET(self) -> None:
        self.answer(self.get)

    def do_POST(self) -> None:
        self.answer(self.post)

    def answer(self, found) -> None:
        """Errors are told in words; other pages of the same browser are told nothing."""
        origin = self.headers.get("Origin")
        if self.headers.get("Host") not in self.server.hosts or (
            origin is not None and urlsplit(origin).netloc not in self.server.hosts
        ):
            self.tell({"error": "for pages of this address only"}, HTTPStatus.FORBIDDEN)
            return
        try:
            found()
        except (DatasetError, ValueError) as error:
            self.tell({"error": str(error)}, HTTPStatus.BAD_REQUEST)
        except OSError as error:
            self.tell({"error": str(error)}, HTTPStatus.INTERNAL_SERVER_ERROR)

    def get(self) -> None:
        path, state = urlsplit(self.path).path, self.server.state
        image = IMAGE.fullmatch(path)
        if path == "/api/project":
            self.tell(state.as_dict())
        elif path == "/api/label":
            self.tell(state.job.as_dict())
        elif image:
            self.send(*state.image(image[1], int(image[2]), small=image[3] is not None))
        else:
            name = "index.html" if path == "/" else path.removeprefix("/page/")
            known = {file.name: file for file in FILES.iterdir() if file.suffix in TYPES}
            if name in known:
                self.send(known[name].read_bytes(), TYPES[known[name].suffix] + "; charset=utf-8")
            else:
                self.tell({"error": f"no page {path}"}, HTTPStatus.NOT_FOUND)

    def post(self) -> None:
        state = self.server.state
        actions = {
            "/api/fit": state.fit,
            "/api/outline": state.outline,
            "/api/save": state.save,
            "/api/label": state.start_labelling,
        }
        action = actions.get(urlsplit(self.path).path)
        asked = self.read_json()
        if action is None:
            self.tell({"error": f"nothing to do at {self.path}"}, HTTPStatus.NOT_FOUND)
        else:
            self.tell(action(asked))

    def read_json(self) -> dict:
        length = self.headers.get("Content-Length", "")
        if not length.isdigit() or int(length) > MOST_BYTES:
            self.close_connection = True  # what follows is not read
            raise ValueError(f"a body of at most {MOST_BYTES >> 20} MiB with its length is needed")
        body = self.rfile.read(int(length))
        if self.headers.get_content_type() != "application/json":
            raise ValueError("content-type: application/json is needed")
        try:
            asked = json.loads(body)
        except ValueError as error:
            raise ValueError(f"not valid JSON: {error}") from None
        if not isinstance(asked, dict):
            raise ValueError("a JSON object is needed")
        return asked

    def tell(self, value: dict, status: HTTPStatus = HTTPStatus.OK) -> None:
        self.send(json.dumps(value).encode(), "application/json", status)

    def send(self, content: bytes, kind: str, status: HTTPStatus = HTTPStatus.OK) -> None:
        self.send_response(status)
        for name, value in (
            ("Content-Type", kind),
            ("Content-Length", str(len(content))),
            ("Cache-Control", "no-store" if kind == "application/json" else "no-cache"),
            ("Content-Security-Policy", POLICY),
            ("X-Content-Type-Options", "nosniff"),
            ("Referrer-Policy", "no-referrer"),
        ):
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, *_) -> None:
        """Nobody reads it."""


def serve(folder: Path, port: int) -> None:
    """Until it is interrupted."""
    with Server(State(folder), port) as server:
        print(f"open {server.url} in a browser on this machine; Ctrl+C ends it", flush=True)
        try:
            server.serve_forever()
        except KeyboardInterrupt:
            print()
