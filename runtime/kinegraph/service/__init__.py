"""`kinegraph serve`: clips over HTTP, for programs that are not Python. Needs the extra `play`.

    requests.py    the JSON of a request as typed, checked values, and the clip it asks for
    app.py         the calls, their queue, and the times of their stages
    openapi.py     the description of the calls, as OpenAPI and as a page
    server.py      the socket, the token, the server

The server keeps nothing between requests: the same request gives the same clip.
"""
