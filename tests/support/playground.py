"""A playground that runs in a thread of the test, and a client for it that uses Python's own HTTP."""

from __future__ import annotations

import http.client
import json
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from kinegraph import MotionPipeline

TEXT = "a person walks slowly to the left"
REQUEST = {"text": TEXT, "seconds": 2, "seed": 7, "steps": 3}


@dataclass(frozen=True)
class Response:
    status: int
    headers: dict[str, str]
    """Names in lower case."""
    body: bytes

    @property
    def json(self) -> Any:
        return json.loads(self.body)


@dataclass(frozen=True)
class PlaygroundClient:
    """Client of a playground that answers at 127.0.0.1:port."""

    port: int

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.port}/"

    def send(self, method: str, path: str, body: bytes | None = None, **headers: str) -> Response:
        """Send one request, unchecked; a keyword like `content_type` becomes the header content-type."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=60)
        try:
            connection.request(method, path, body, {name.replace("_", "-"): value for name, value in headers.items()})
            response = connection.getresponse()
            named = {name.lower(): value for name, value in response.getheaders()}
            return Response(response.status, named, response.read())
        finally:
            connection.close()

    def post(self, path: str, value: object, tab: str = "test") -> Response:
        """Post JSON, or bytes as they are."""
        data = value if isinstance(value, bytes) else json.dumps(value).encode()
        return self.send("POST", path, data, content_type="application/json", kinegraph_tab=tab)

    @contextmanager
    def events(self, request: object, tab: str = "test") -> Iterator[Iterator[dict[str, Any]]]:
        """Ask for a clip and read its events; leaving the block closes the connection, even before the last event."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=60)
        try:
            headers = {"Content-Type": "application/json", "Kinegraph-Tab": tab}
            connection.request("POST", "/api/clip", json.dumps(request), headers)
            response = connection.getresponse()
            assert response.status == 200, response.read()
            yield (json.loads(line) for line in response)
        finally:
            connection.close()

    def clip(self, request: object, tab: str = "test") -> list[dict[str, Any]]:
        """Ask for a clip and return all of its events."""
        with self.events(request, tab) as events:
            return list(events)


@contextmanager
def running_playground(pipeline: MotionPipeline) -> Iterator[PlaygroundClient]:
    """Run a playground until the end of the block."""
    from kinegraph.playground.app import Playground
    from kinegraph.playground.server import Server, listen

    with listen(0) as listener:
        port = listener.getsockname()[1]
        server = Server(Playground(pipeline), port)
        thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]}, daemon=True)
        thread.start()
        deadline = time.monotonic() + 20
        while not server.started:
            assert time.monotonic() < deadline
            time.sleep(0.01)
        try:
            yield PlaygroundClient(port)
        finally:
            server.should_exit = True
            thread.join(20)
            assert not thread.is_alive()
