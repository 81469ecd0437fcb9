"""SOVD (ISO 17978-3): the fault memory and UDS of a gateway as resources of HTTP. It keeps nothing but locks.

One file a resource: entities, faults, data, configurations, modes, operations, locks, logs, bulk data, subscriptions.
:mod:`gateway_serve.sovd.table` says what an endpoint is, :mod:`gateway_serve.sovd.app` puts them together.
"""
