"""Files of the page, read once when the server starts: only these names are served."""

import gzip
import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from aiohttp import web

# The tables of the host may have others, with which a browser runs no module.
_TYPES = {
    ".css": "text/css",
    ".html": "text/html",
    ".js": "text/javascript",
    ".svg": "image/svg+xml",
    "": "text/plain",  # the licence of uPlot
}


@dataclass(frozen=True)
class StaticFile:
    """One file of the page."""

    content_type: str
    etag: str  # changes with the content
    body: bytes
    packed: bytes  # the same by gzip

    def answer(self, request: web.Request) -> web.Response:
        """Return the file, compressed where the client accepts that; 304 where the client has it already."""
        headers = {"ETag": f'"{self.etag}"', "Vary": "Accept-Encoding"}
        if any(known.value == self.etag for known in request.if_none_match or ()):
            return web.Response(status=304, headers=headers)
        body = self.body
        if "gzip" in request.headers.get("Accept-Encoding", ""):
            body, headers["Content-Encoding"] = self.packed, "gzip"
        charset = "utf-8" if self.content_type.startswith("text/") else None
        return web.Response(body=body, content_type=self.content_type, charset=charset, headers=headers)


def read_static(folder: Path) -> Mapping[str, StaticFile]:
    """Return the files of a folder by their names below it; files of other types than ours are not served."""
    found = {}
    for path in sorted(folder.rglob("*")):
        if path.is_file() and path.suffix in _TYPES:
            body = path.read_bytes()
            etag = hashlib.sha256(body).hexdigest()
            file = StaticFile(_TYPES[path.suffix], etag, body, gzip.compress(body, mtime=0))
            found[path.relative_to(folder).as_posix()] = file
    return found
