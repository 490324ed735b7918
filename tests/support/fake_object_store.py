"""An object store in a child process, for tests of its clients: it records requests, and fails on cue.

It plays the parts of S3, of Google's XML interface and of Azure's blobs used by obstore: objects with conditions and
ranges, and for the first two also listings in pages and bulk removals. Signatures are not checked. It is a process of
its own, since obstore can hold Python's lock while it waits for an answer.
"""

import json
import re
import socket
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from threading import Lock, Thread
from typing import Any
from urllib.parse import parse_qs, unquote, urlsplit
from urllib.request import Request as Question
from urllib.request import urlopen
from xml.sax.saxutils import escape, unescape

from tests.support import ROOT

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


EXPIRED = b"""<?xml version="1.0" encoding="UTF-8"?>
<Error><Code>ExpiredToken</Code><Message>The provided token has expired.</Message><Token-0>a-secret</Token-0></Error>"""
PAGE = 1000
"""Keys per page of a listing, as in real stores."""
_CONTROL = "/.control"


@dataclass
class RecordedRequest:
    """A request: the key of the object with its bucket, or for a listing the prefix of its keys.

    ``kind`` is get, head, put, delete, "delete many" or list: one page of a listing.
    """

    method: str
    key: str
    headers: dict[str, str]
    kind: str


@dataclass
class InjectedFault:
    """A fault: from put number ``after`` of a key beginning with ``mark`` on, the next ``left`` requests fail.

    ``how`` is a status to answer with, "drop" to close the connection, "lost" to do the request and then close it, or
    "expired" to answer as S3 does to an expired credential.
    """

    after: int = 0
    left: float = 0
    how: int | str = 503
    mark: str = "bucket/plane.zarr/regime/c/"

    def of(self, request: RecordedRequest) -> int | str | None:
        """The fault of a request."""
        self.after -= request.method == "PUT" and request.key.startswith(self.mark)
        if self.after > 0 or self.left <= 0:
            return None
        self.left -= 1
        return self.how


@dataclass
class _ServerState:
    """Objects by bucket and key, each with its generation; all requests so far; the fault; a delay."""

    objects: dict[str, tuple[bytes, int]] = field(default_factory=dict)
    requests: list[RecordedRequest] = field(default_factory=list)
    trouble: InjectedFault = field(default_factory=InjectedFault)
    delay: float = 0.0
    generation: int = field(default_factory=time.time_ns)  # no two servers give two objects one tag
    lock: Lock = field(default_factory=Lock)

    def control(self, asked: dict[str, Any]) -> Any:
        """Commands of the test from its own process."""
        if "trouble" in asked:
            self.trouble = InjectedFault(**asked["trouble"])
        if "delay" in asked:
            self.delay = asked["delay"]
        if "put" in asked:
            self.generation += 1
            self.objects.update({key: (text.encode("latin-1"), self.generation) for key, text in asked["put"].items()})
        if "forget" in asked:
            self.requests.clear()
        return {
            "trouble": asdict(self.trouble),
            "requests": [asdict(request) for request in self.requests] if "requests" in asked else [],
            "objects": {key: generation for key, (_, generation) in self.objects.items()} if "objects" in asked else {},
            "counts": Counter(request.kind for request in self.requests),
        }

    def holds(self, key: str, headers: dict[str, str]) -> bool:
        """Whether the conditions of a put hold."""
        _, generation = self.objects.get(key, (b"", 0))
        if headers.get("if-none-match") == "*" and generation:
            return False
        if headers.get("if-match") not in (None, f'"{generation}"'):
            return False
        return headers.get("x-goog-if-generation-match") in (None, str(generation))

    def answer(self, request: RecordedRequest, query: dict[str, list[str]], body: bytes) -> tuple[int, bytes, int]:
        """Status, body and the generation of the object."""
        key = request.key
        if request.method == "POST":  # S3 removes many objects at once
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
            return 200, self.listing(f"{key.partition('/')[0]}/", query), 0
        data, generation = self.objects.get(key, (b"", 0))
        return (200, data, generation) if generation else (404, b"", 0)

    def listing(self, bucket: str, query: dict[str, list[str]]) -> bytes:
        prefix, delimiter, after = (query.get(k, [""])[0] for k in ("prefix", "delimiter", "continuation-token"))
        keys = sorted(key.removeprefix(bucket) for key in self.objects if key.startswith(bucket + prefix))
        folders = {prefix + k.removeprefix(prefix).partition("/")[0] + "/" for k in keys if "/" in k[len(prefix) :]}
        if delimiter:
            keys = [key for key in keys if "/" not in key.removeprefix(prefix)]
        more = [key for key in keys if key > after]
        keys, rest = more[:PAGE], more[PAGE:]
        shown = "".join(
            f"<Contents><Key>{escape(key)}</Key><LastModified>2015-10-21T07:28:00.000Z</LastModified>"
            f"<ETag>1</ETag><Size>{len(self.objects[bucket + key][0])}</Size></Contents>"
            for key in keys
        )
        if delimiter:
            shown += "".join(f"<CommonPrefixes><Prefix>{escape(f)}</Prefix></CommonPrefixes>" for f in sorted(folders))
        shown += f"<NextContinuationToken>{escape(keys[-1])}</NextContinuationToken>" if rest else ""
        truncated = str(bool(rest)).lower()
        return f"<ListBucketResult><IsTruncated>{truncated}</IsTruncated>{shown}</ListBucketResult>".encode()


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    disable_nagle_algorithm = True
    served: _ServerState

    def reply(self) -> None:
        body = self.rfile.read(int(self.headers.get("content-length") or 0))
        parts = urlsplit(self.path)
        if parts.path == _CONTROL:
            with self.served.lock:
                answer = json.dumps(self.served.control(json.loads(body))).encode()
            self.answer(200, answer, {})
            return
        query = parse_qs(parts.query, keep_blank_values=True)
        headers = {name.lower(): value for name, value in self.headers.items()}
        kind = {"POST": "delete many"}.get(self.command, "list" if "list-type" in query else self.command.lower())
        prefix = f"/{query.get('prefix', [''])[0]}" if kind == "list" else ""
        request = RecordedRequest(self.command, unquote(parts.path).strip("/") + prefix, headers, kind)
        time.sleep(self.served.delay)
        with self.served.lock:
            self.served.requests.append(request)
            trouble = self.served.trouble.of(request)
            status, data, generation = trouble, b"", 0
            if trouble is None or trouble == "lost":
                status, data, generation = self.served.answer(request, query, body)
        if trouble == "expired":
            status, data, trouble = 400, EXPIRED, 400
        if isinstance(trouble, str):
            self.connection.shutdown(socket.SHUT_RDWR)
            self.close_connection = True
            return
        assert isinstance(status, int)
        tags = {"etag": f'"{generation}"', "x-goog-generation": str(generation)} if generation else {}
        if generation and (wanted := re.fullmatch(r"bytes=(\d*)-(\d*)", headers.get("range", ""))):
            first, last = wanted.groups()
            begin = int(first) if first else max(0, len(data) - int(last))
            end = min(int(last) + 1, len(data)) if first and last else len(data)
            tags["content-range"] = f"bytes {begin}-{end - 1}/{len(data)}"
            status, data = 206, data[begin:end]
        self.answer(status, data, tags)

    def answer(self, status: int, data: bytes, headers: dict[str, str]) -> None:
        self.send_response(status)
        for name, value in ({"content-length": str(len(data)), "last-modified": DATE} | headers).items():
            self.send_header(name, value)
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(data)

    do_GET = do_HEAD = do_PUT = do_POST = do_DELETE = reply

    def log_message(self, *_: object) -> None:
        pass


class FakeObjectStore:
    """The server from the view of a test: its requests, objects and faults."""

    def __init__(self, url: str) -> None:
        self.url = url

    @property
    def environment(self) -> dict[str, str]:
        """The variables by which clients of all three kinds find the server."""
        return dict.fromkeys(ENDPOINTS, self.url) | CREDENTIALS

    @property
    def requests(self) -> list[RecordedRequest]:
        """All requests so far, including failed ones."""
        return [RecordedRequest(**request) for request in self._control(requests=True)["requests"]]

    @property
    def counts(self) -> Counter[str]:
        """Number of requests of each kind since the last ``forget``."""
        return Counter(self._control()["counts"])

    def forget(self) -> None:
        """Reset the counts."""
        self._control(forget=True)

    @property
    def objects(self) -> dict[str, int]:
        """The generation of each object, by bucket and key."""
        found: dict[str, int] = self._control(objects=True)["objects"]
        return found

    def put(self, objects: dict[str, bytes]) -> None:
        """Put objects, by bucket and key, without a request."""
        self._control(put={key: data.decode("latin-1") for key, data in objects.items()})

    @property
    def trouble(self) -> InjectedFault:
        """The current fault."""
        return InjectedFault(**self._control()["trouble"])

    @trouble.setter
    def trouble(self, trouble: InjectedFault) -> None:
        self._control(trouble=asdict(trouble))

    def delay(self, seconds: float) -> None:
        """Answer each request after this delay, also many at once."""
        self._control(delay=seconds)

    def _control(self, **asked: Any) -> Any:
        with urlopen(Question(self.url + _CONTROL, json.dumps(asked).encode(), method="POST"), timeout=60) as answer:
            return json.loads(answer.read())


@contextmanager
def object_store() -> Iterator[FakeObjectStore]:
    """An empty store, serving inside the ``with`` block."""
    command = [sys.executable, "-m", "tests.support.fake_object_store"]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    with subprocess.Popen(command, cwd=ROOT, **pipes) as process:  # type: ignore[call-overload]
        yield FakeObjectStore(process.stdout.readline().decode().strip())  # the end of its stdin ends it


def main() -> None:
    """Serve at a free port, printed on stdout, until stdin ends."""

    class _FakeObjectServer(ThreadingHTTPServer):
        daemon_threads = True
        request_queue_size = 1024

    _Handler.served = _ServerState()
    with _FakeObjectServer(("127.0.0.1", 0), _Handler) as server:
        Thread(target=server.serve_forever, args=(0.05,), daemon=True).start()
        print(f"http://127.0.0.1:{server.server_port}", flush=True)
        sys.stdin.read()
        server.shutdown()


if __name__ == "__main__":
    main()
