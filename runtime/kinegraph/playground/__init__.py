"""`kinegraph play`: a page on loopback that makes clips while one looks on. Needs the extra `play`.

    guard.py    who may ask: this machine's own pages, with requests of bounded size
    app.py      what may be asked: parse, edit, a clip as a stream of events, a file of it
    wishes.py   a request's JSON as typed wishes
    making.py   a wish as events, clip and latencies
    turns.py    whose turn it is: one clip at a time, tab by tab
    server.py   the socket, the browser, the end

The server keeps nothing between requests: the same wish gives the same clip, and a file is made anew from its wish.
"""
