"""``python -m gss.device.simulator``."""

from __future__ import annotations

import sys

from gss import process


def main() -> None:
    """Run the simulator and end the process."""
    process.starting()
    from gss.device.simulator.program import main as run

    try:
        sys.exit(run())
    finally:
        process.ending()


if __name__ == "__main__":
    main()
