"""A playground in a thread of the test, and requests to it by Python's own client."""

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
WISH = {"text": TEXT, "seconds": 2, "seed": 7, "steps": 3}


@dataclass(frozen=True)
class Answer:
    status: int
    headers: dict[str, str]
    body: bytes

    @property
    def json(self) -> Any:
        return json.loads(self.body)


@dataclass(frozen=True)
class Playing:
    """A server that answers at 127.0.0.1:port."""

    port: int

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.port}/"

    def send(self, method: str, path: str, body: bytes | None = None, **headers: str) -> Answer:
        """One request as it is told; `host_` and the like become Host."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=60)
        try:
            connection.request(
                method, path, body, {name.strip("_").replace("_", "-"): v for name, v in headers.items()}
            )
            response = connection.getresponse()
            named = {name.lower(): value for name, value in response.getheaders()}
            return Answer(response.status, named, response.read())
        finally:
            connection.close()

    def post(self, path: str, value: object, tab: str = "test") -> Answer:
        data = value if isinstance(value, bytes) else json.dumps(value).encode()
        return self.send("POST", path, data, content_type="application/json", kinegraph_tab=tab)

    @contextmanager
    def events(self, wish: object, tab: str = "test") -> Iterator[Iterator[dict[str, Any]]]:
        """The events of a clip; leaving closes the connection, whatever is still to come."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=60)
        try:
            headers = {"Content-Type": "application/json", "Kinegraph-Tab": tab}
            connection.request("POST", "/api/clip", json.dumps(wish), headers)
            response = connection.getresponse()
            assert response.status == 200, response.read()
            yield (json.loads(line) for line in response)
        finally:
            connection.close()

    def clip(self, wish: object, tab: str = "test") -> list[dict[str, Any]]:
        with self.events(wish, tab) as events:
            return list(events)


@contextmanager
def playing(pipeline: MotionPipeline) -> Iterator[Playing]:
    """A server until the end of the block."""
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
            yield Playing(port)
        finally:
            server.should_exit = True
            thread.join(20)
            assert not thread.is_alive()
