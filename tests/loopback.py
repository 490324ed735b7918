"""An object store in this process, for tests of what is asked of one: it keeps a record, and fails on cue.

It plays what obstore asks of S3, of Google's XML interface and of Azure's blobs: whole objects with their conditions,
and for the first two listings. Nothing is checked of signatures.
"""

import re
import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from threading import Lock, Thread
from urllib.parse import parse_qs, unquote, urlsplit
from xml.sax.saxutils import escape, unescape

DATE = "Wed, 21 Oct 2015 07:28:00 GMT"
ENDPOINTS = ("AWS_ENDPOINT_URL", "GOOGLE_BASE_URL", "AZURE_STORAGE_ENDPOINT")
CREDENTIALS = {
    "AWS_ACCESS_KEY_ID": "any",
    "AWS_SECRET_ACCESS_KEY": "any",
    "AWS_REGION": "us-east-1",
    "GOOGLE_BEARER_TOKEN": "any",
    "AZURE_STORAGE_ACCOUNT_NAME": "any",
    "AZURE_SKIP_SIGNATURE": "true",
}


@dataclass
class Request:
    """What was asked: the key is that of the object, with its bucket."""

    method: str
    key: str
    headers: dict[str, str]


@dataclass
class ObjectStore:
    """Objects by bucket and key, each with its generation; all requests so far; and what is to go wrong.

    ``trouble`` is asked at each request: a status to answer with, "drop" to close the connection, "lost" to do what is
    asked and then close it, or None.
    """

    url: str = ""
    objects: dict[str, tuple[bytes, int]] = field(default_factory=dict)
    requests: list[Request] = field(default_factory=list)
    trouble: Callable[[Request], int | str | None] = lambda _: None
    generation: int = 0
    lock: Lock = field(default_factory=Lock)

    @property
    def environment(self) -> dict[str, str]:
        """The variables by which clients of all three kinds find it."""
        return dict.fromkeys(ENDPOINTS, self.url) | CREDENTIALS

    def holds(self, key: str, headers: dict[str, str]) -> bool:
        """Whether the conditions of a put hold."""
        _, generation = self.objects.get(key, (b"", 0))
        if headers.get("if-none-match") == "*" and generation:
            return False
        if headers.get("if-match") not in (None, f'"{generation}"'):
            return False
        return headers.get("x-goog-if-generation-match") in (None, str(generation))

    def answer(self, request: Request, query: dict[str, list[str]], body: bytes) -> tuple[int, bytes, int]:
        """Status, body and the generation of the object."""
        key = request.key
        if request.method == "POST":  # S3 removes many at once
            found = re.findall(r"<Key>(.*?)</Key>", body.decode())
            for name in found:
                self.objects.pop(f"{key.strip('/')}/{unescape(name)}", None)
            shown = "".join(f"<Deleted><Key>{name}</Key></Deleted>" for name in found)
            return 200, f"<DeleteResult>{shown}</DeleteResult>".encode(), 0
        if request.method == "PUT":
            if not self.holds(key, request.headers):
                return 412, b"", 0
            self.generation += 1
            self.objects[key] = (body, self.generation)
            return 201 if "x-ms-version" in request.headers else 200, b"", self.generation
        if request.method == "DELETE":
            return (204, b"", 0) if self.objects.pop(key, None) else (404, b"", 0)
        if "list-type" in query:
            return 200, self.listing(f"{key.strip('/')}/", query), 0
        data, generation = self.objects.get(key, (b"", 0))
        return (200, data, generation) if generation else (404, b"", 0)

    def listing(self, bucket: str, query: dict[str, list[str]]) -> bytes:
        prefix, delimiter = (query.get(name, [""])[0] for name in ("prefix", "delimiter"))
        keys = sorted(key.removeprefix(bucket) for key in self.objects if key.startswith(bucket + prefix))
        folders = {prefix + k.removeprefix(prefix).partition("/")[0] + "/" for k in keys if "/" in k[len(prefix) :]}
        if delimiter:
            keys = [key for key in keys if "/" not in key.removeprefix(prefix)]
        shown = "".join(
            f"<Contents><Key>{escape(key)}</Key><LastModified>2015-10-21T07:28:00.000Z</LastModified>"
            f"<ETag>1</ETag><Size>{len(self.objects[bucket + key][0])}</Size></Contents>"
            for key in keys
        )
        if delimiter:
            shown += "".join(f"<CommonPrefixes><Prefix>{escape(f)}</Prefix></CommonPrefixes>" for f in sorted(folders))
        return f"<ListBucketResult><IsTruncated>false</IsTruncated>{shown}</ListBucketResult>".encode()


@contextmanager
def object_store() -> Iterator[ObjectStore]:
    """An empty one, serving at ``url`` inside the ``with`` block."""
    store = ObjectStore()

    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def reply(self) -> None:
            body = self.rfile.read(int(self.headers.get("content-length") or 0))
            parts = urlsplit(self.path)
            headers = {name.lower(): value for name, value in self.headers.items()}
            request = Request(self.command, unquote(parts.path).lstrip("/"), headers)
            with store.lock:
                store.requests.append(request)
                trouble = store.trouble(request)
                if isinstance(trouble, int):
                    status, data, generation = trouble, b"", 0
                elif trouble != "drop":
                    query = parse_qs(parts.query, keep_blank_values=True)
                    status, data, generation = store.answer(request, query, body)
            if isinstance(trouble, str):
                self.connection.shutdown(socket.SHUT_RDWR)
                self.close_connection = True
                return
            self.send_response(status)
            for name, value in {"content-length": len(data), "last-modified": DATE}.items():
                self.send_header(name, str(value))
            if generation:
                self.send_header("etag", f'"{generation}"')
                self.send_header("x-goog-generation", str(generation))
            self.end_headers()
            if self.command != "HEAD":
                self.wfile.write(data)

        do_GET = do_HEAD = do_PUT = do_POST = do_DELETE = reply

        def log_message(self, *_: object) -> None:
            pass

    class Server(ThreadingHTTPServer):
        daemon_threads = True

    with Server(("127.0.0.1", 0), Handler) as server:
        thread = Thread(target=server.serve_forever, args=(0.05,))
        thread.start()
        store.url = f"http://127.0.0.1:{server.server_port}"
        yield store
        server.shutdown()
        thread.join()
