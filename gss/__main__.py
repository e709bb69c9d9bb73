"""``python -m gss`` and the ``gss`` script."""

from __future__ import annotations

import sys

from gss import process
from gss.cli import main as run


def main() -> None:
    """Entry point of the installed script."""
    process.starting()
    try:
        sys.exit(run())
    finally:
        process.ending()


if __name__ == "__main__":
    main()
