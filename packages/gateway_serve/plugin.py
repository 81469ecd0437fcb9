"""Plug-in of the sockets and the page: what shows a running gateway, asks it, reports to it, publishes its data."""

from gateway.plugin import Plugin

PLUGIN = Plugin(
    commands={name: f"gateway_serve.commands:{name}" for name in ("serve", "watch", "request", "report", "mqtt")},
    calls={
        "page_process": "gateway_serve.cli.page_process:PageProcess",
        "run_report": "gateway_serve.cli.run_report:RunReport",
        "status_socket": "gateway_serve.status_socket:StatusSocket",
        "external_reports": "gateway_serve.external_reports:ExternalReports",
        "report_socket": "gateway_serve.report_socket:ReportSocket",
    },
)
