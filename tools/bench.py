"""Measure the performance of GSS: one thread, fixed seeds, processor time.

``python -m tools.bench [--quick] [--json | --markdown] [section …]``, or ``make bench`` for all sections. Tables are
printed to the terminal. With ``--json`` standard output is one JSON document and the tables are printed to standard
error. The benchmarks are not part of the tests, because results depend on the machine. Peers (sep, tetra3rs) are
measured in the same run if installed (``pip install -e .[dev,bench]``), and listed as skipped otherwise.
"""

from __future__ import annotations

import os

for _variable in (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "NUMBA_NUM_THREADS",
    "RAYON_NUM_THREADS",
):
    os.environ[_variable] = "1"  # must be set before numpy is imported

import argparse  # noqa: E402 - here and below: after the threads are limited
import json  # noqa: E402
import sys  # noqa: E402
from collections.abc import Callable, Sequence  # noqa: E402
from pathlib import Path  # noqa: E402
from typing import Any  # noqa: E402

from tools.bench_api import api  # noqa: E402
from tools.bench_browser import page_load  # noqa: E402
from tools.bench_catalogue import catalogues  # noqa: E402
from tools.bench_frames import chains, detection, rendering  # noqa: E402
from tools.bench_identify import lost_in_space, near_attitude  # noqa: E402
from tools.bench_ingest import ingest  # noqa: E402
from tools.bench_line import packets, transfers  # noqa: E402
from tools.bench_page import updated  # noqa: E402
from tools.bench_profile import profiles  # noqa: E402
from tools.bench_reprocess import reprocessing  # noqa: E402
from tools.bench_tables import BenchTable, machine  # noqa: E402
from tools.bench_tasks import page_tasks  # noqa: E402

SECTIONS: dict[str, Callable[[bool], list[BenchTable]]] = {
    "render": rendering,
    "centroid": detection,
    "chain": chains,
    "lost_in_space": lost_in_space,
    "near_attitude": near_attitude,
    "profile": profiles,
    "catalogue": catalogues,
    "packets": packets,
    "transfer": transfers,
    "ingest": ingest,
    "reprocess": reprocessing,
    "api": api,
    "page_load": page_load,
    "page_tasks": page_tasks,
}


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the sections and print the tables."""
    parser = _parser()
    options = parser.parse_args(arguments)
    unknown = [name for name in options.sections if name not in SECTIONS]
    if unknown:
        parser.error(f"unknown section {', '.join(unknown)}; valid sections: {', '.join(SECTIONS)}")
    at_start = machine()
    output = sys.stderr if options.json else sys.stdout
    tables: list[BenchTable] = []
    for name in options.sections or SECTIONS:
        for table in SECTIONS[name](options.quick):
            tables.append(table)
            print(table.markdown() if options.markdown else table.text(), file=output, flush=True)
    if options.update:
        options.update.write_text(updated(options.update.read_text(), tables))
    report = _report(at_start, options.quick, tables)
    if options.json:
        json.dump(report, sys.stdout, indent=1)
        print()
    else:
        print(json.dumps(report["machine"]), file=output)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m tools.bench", description=__doc__)
    parser.add_argument(
        "sections", nargs="*", metavar="section", help=f"one or more of {', '.join(SECTIONS)}; default: all"
    )
    parser.add_argument("--quick", action="store_true", help="a few repetitions only: checks that the benchmarks run")
    parser.add_argument(
        "--update", type=Path, metavar="PAGE", help="replace the tables in this page, for example docs/benchmarks.md"
    )
    output_format = parser.add_mutually_exclusive_group()
    output_format.add_argument("--json", action="store_true", help="one JSON document on standard output")
    output_format.add_argument("--markdown", action="store_true", help="tables for docs/benchmarks.md")
    return parser


def _report(at_start: dict[str, Any], quick: bool, tables: list[BenchTable]) -> dict[str, Any]:
    return {
        "machine": at_start | {"load_average_at_end": machine()["load_average"]},
        "threads": 1,
        "quick": quick,
        "tables": [table.plain() for table in tables],
    }


if __name__ == "__main__":
    main()
