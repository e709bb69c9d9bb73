"""``python -m gss.device.simulator``."""

from __future__ import annotations

import sys

from gss import garbage


def main() -> None:
    """Run the simulator and end the process."""
    garbage.collect_rarely()
    from gss.device.simulator.program import main as run

    try:
        sys.exit(run())
    finally:
        garbage.skip_last_collection()


if __name__ == "__main__":
    main()
