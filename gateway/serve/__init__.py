"""The page: what a daemon says on its status socket, over HTTP, in another process.

Nothing here is on the way of a frame. A reader of the status socket (:mod:`.link`) feeds a hub (:mod:`.hub`), which
keeps the last ten minutes (:mod:`.history`) and what the fault memory's file says (:mod:`.memory`); an application of
Starlette (:mod:`.app`) behind a guard (:mod:`.guard`) shows them to browsers and to Prometheus (:mod:`.metrics`).
"""
