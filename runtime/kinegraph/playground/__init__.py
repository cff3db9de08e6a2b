"""`kinegraph play`: a page on loopback that generates clips while one watches. Needs the extra `play`.

    guards.py       limits of a server, and the middleware that keeps those of one request
    connections.py  time limits and number of connections, for any application of uvicorn
    middleware.py   admits requests of this machine's own pages
    app.py          six calls: parse, unknown words, edit, a clip as a stream of events, a file, a character
    page.py         the page: what it is told of the bundle, and the clip that it opens with
    schemas.py      the JSON of a request as typed, checked values
    jobs.py         one clip: its events, the result, and the time of each stage
    fair_queue.py   one clip at a time, tab by tab
    server.py       the socket, the server, the browser

The server stores nothing: the same request gives the same clip, and a file is generated anew. It remembers the latest
64 parts of timelines, by what they were made from, so that only what changed is made again (`kinegraph.timeline`).
"""
