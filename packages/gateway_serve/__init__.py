"""The page: a daemon's status socket, shown over HTTP, in another process.

Nothing here is on the way of a frame. A reader of the status socket (:mod:`.link`) feeds a hub (:mod:`.hub`), which
keeps the last ten minutes (:mod:`.history`) and the contents of the fault memory's file (:mod:`.memory`); an
application of Starlette (:mod:`.app`) with a guard (:mod:`.guard`) shows them to browsers and to Prometheus
(:mod:`.metrics`).
"""
