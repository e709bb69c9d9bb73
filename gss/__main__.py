"""``python -m gss`` and the ``gss`` script."""

from __future__ import annotations

import sys

from gss import garbage
from gss.cli import main as run


def main() -> None:
    """Entry point of the installed script."""
    garbage.collect_rarely()
    try:
        sys.exit(run())
    finally:
        garbage.skip_last_collection()


if __name__ == "__main__":
    main()
