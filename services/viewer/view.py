"""`clew view`: a recording with its scene, served to a viewer in the browser together with layouts and the report."""

import tempfile
import webbrowser
from collections.abc import Mapping
from functools import partial
from html import escape
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.parse import quote

import foxglove

from services.console.replay import spoken
from services.recorder.page import page
from services.recorder.page_data import page_data
from services.recorder.reading import Session
from services.recorder.walk import path_of
from services.session_files import complain, session_file
from services.viewer import layout
from services.viewer.pictures import Pictures

VIEWERS = {
    "Foxglove": "https://app.foxglove.dev/~/view?ds=remote-file&ds.url={file}",
    "Lichtblick on this machine": "http://localhost:8080/?ds=remote-file&ds.url={file}&layoutUrl={layout}",
}


def command(given: Path, port: int, browser: bool) -> int:
    """Serve until Ctrl-C. Returns 2 where the file is no recording, 1 where the port is taken."""
    try:
        session = Session(session_file(given))
    except (OSError, ValueError) as error:
        return complain(error)
    with tempfile.TemporaryDirectory() as folder:
        files = prepare(session, Path(folder))
        try:
            server = serve(files, port)
        except OSError as error:
            complain(OSError(f"port {port}: {error.strerror}"))
            return 1
        address = f"http://127.0.0.1:{server.server_port}/"
        print(f"{address} shows {session.file}; Ctrl-C stops")  # noqa: T201
        if browser:
            webbrowser.open(address)
        try:
            server.serve_forever()
        except KeyboardInterrupt:
            return 0
    return 0


def prepare(session: Session, folder: Path) -> dict[str, Path]:
    """What is served: name in the address -> file."""
    files = {name: folder / (name or "index.html") for name in ("", "session.mcap", "foxglove.json", "lichtblick.json")}
    write_pictures(session, files["session.mcap"])
    files["foxglove.json"].write_text(layout.foxglove())
    files["lichtblick.json"].write_text(layout.lichtblick())
    files[""].write_text(page([page_data(session, session.file.resolve().parent.name)]))
    return files


def write_pictures(session: Session, file: Path) -> None:
    """A copy of the recording with scene, transforms and log beside the topics."""
    context = foxglove.Context()
    with foxglove.open_mcap(file, context=context):
        pictures = Pictures(context, path_of(session))
        for t_s, key, payload in spoken(session):
            pictures.take(key, payload, session.start_ns + round(t_s * 1e9))


def serve(files: Mapping[str, Path], port: int) -> ThreadingHTTPServer:
    """On this machine only. Raises OSError where the port is taken."""
    return ThreadingHTTPServer(("127.0.0.1", port), partial(_Files, files))


def links(address: str) -> str:
    """HTML to put on top of the page: where to open the recording, and with which layout."""
    file, whole = (quote(f"{address}{name}", safe="") for name in ("session.mcap", "lichtblick.json"))
    opened = [
        f'<a href="{escape(target.format(file=file, layout=whole))}">{name}</a>' for name, target in VIEWERS.items()
    ]
    layouts = [f'<a download href="{name}">{name}</a>' for name in ("foxglove.json", "lichtblick.json")]
    return f'<p id="viewers">Open the recording in {", ".join(opened)}; layouts to import there: {", ".join(layouts)}; \
<a href="session.mcap">session.mcap</a> with the scene.</p>'


class _Files(BaseHTTPRequestHandler):
    """GET and HEAD of a few files, in parts where the viewer asks for parts, to pages from anywhere."""

    protocol_version = "HTTP/1.1"

    def __init__(self, files: Mapping[str, Path], *arguments: object) -> None:
        self._files = files
        super().__init__(*arguments)  # pyright: ignore[reportArgumentType]

    def do_GET(self) -> None:
        """The file, or the part that was asked for."""
        self._answer(body=True)

    def do_HEAD(self) -> None:
        """Its size."""
        self._answer(body=False)

    def do_OPTIONS(self) -> None:
        """A browser asks before it asks for a part."""
        self._head(HTTPStatus.NO_CONTENT, 0, "text/plain")

    def _answer(self, *, body: bool) -> None:
        file = self._files.get(self.path.partition("?")[0].removeprefix("/"))
        if file is None:
            self._head(HTTPStatus.NOT_FOUND, 0, "text/plain")
            return
        data = file.read_bytes()
        if file.suffix == ".html":
            address = f"http://{self.headers.get('Host', '127.0.0.1')}/"
            data = data.replace(b"</header>", links(address).encode() + b"</header>", 1)
        first, end = _asked(self.headers.get("Range", ""), len(data))
        part = data[first:end]
        partial_ = len(part) < len(data)
        kind = {".html": "text/html; charset=utf-8", ".json": "application/json"}.get(
            file.suffix, "application/octet-stream"
        )
        more = {"Content-Range": f"bytes {first}-{end - 1}/{len(data)}"} if partial_ else {}
        self._head(HTTPStatus.PARTIAL_CONTENT if partial_ else HTTPStatus.OK, len(part), kind, more)
        if body:
            self.wfile.write(part)

    def _head(self, status: HTTPStatus, size: int, kind: str, more: Mapping[str, str] | None = None) -> None:
        self.send_response(status)
        headers = {
            "Content-Type": kind,
            "Content-Length": str(size),
            "Accept-Ranges": "bytes",
            "Access-Control-Allow-Origin": "*",
            "Access-Control-Allow-Headers": "Range",
            "Access-Control-Allow-Private-Network": "true",
            "Access-Control-Expose-Headers": "Content-Length, Content-Range, Accept-Ranges",
        }
        for name, value in (headers | dict(more or {})).items():
            self.send_header(name, value)
        self.end_headers()

    def log_message(self, format: str, *args: object) -> None:  # noqa: A002
        """Silence."""


def _asked(header: str, size: int) -> tuple[int, int]:
    """First byte and end of a Range header; all where it is none that can be answered."""
    first, dash, last = header.removeprefix("bytes=").partition("-")
    if not dash or "," in header:
        return 0, size
    if not first:
        return max(size - int(last), 0), size
    end = min(int(last) + 1, size) if last else size
    return (int(first), end) if first.isdigit() and int(first) < end else (0, size)
