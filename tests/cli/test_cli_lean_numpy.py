"""The first import of scipy in `gss solve` and `gss serve`."""

from __future__ import annotations

import subprocess
import sys

PROGRAM = """
import sys
from gss.cli.lean_numpy import hide_build_tools
hide_build_tools()
from scipy.spatial import cKDTree
print("numpy.f2py" in sys.modules, "numpy.testing" in sys.modules)
import numpy.testing
print(hasattr(numpy.testing, "assert_allclose"), len(cKDTree([[0.0, 1.0], [2.0, 3.0]]).query([0.0, 1.0])))
"""


def test_scipy_does_not_import_the_build_tools_of_numpy() -> None:
    """The tools are not imported with scipy, and can be imported by name afterwards."""
    done = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["False", "False", "True", "2"]
