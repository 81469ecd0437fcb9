"""A console that folds what is too long."""

from __future__ import annotations

from typing import Any

from rich.console import Console
from rich.table import Table


class FoldingConsole(Console):
    """Folds what is too long for its column of a table, and never cuts it; titles are as wide as the screen."""

    def print(self, *objects: Any, **options: Any) -> None:
        """Print; see rich."""
        for item in objects:
            if isinstance(item, Table):
                for column in item.columns:
                    column.overflow = "fold"
                if item.title:
                    super().print(item.title, style="italic", soft_wrap=True)
                    item.title = None
        super().print(*objects, **options)
