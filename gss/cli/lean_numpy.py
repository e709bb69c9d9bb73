"""A faster first import of scipy."""

from __future__ import annotations

UNUSED = ("f2py", "testing", "ctypeslib")
"""Build and test tools among the submodules of numpy."""


def hide_build_tools() -> None:
    """Remove numpy's build and test tools from its list of submodules, which numpy imports only on access.

    The first import of scipy copies every listed name of numpy (``array_api_compat``) and so imports these tools: 0.1 s
    and 8 MB. They can still be imported by name. Call this before the first import of scipy.
    """
    import numpy as np

    listed: set[str] = getattr(np, "__numpy_submodules__", set())
    for name in UNUSED:
        listed.discard(name)
        if name in np.__all__:
            np.__all__.remove(name)
