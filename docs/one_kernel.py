"""Run all notebooks of the site in one kernel, which imports and loads compiled code once.

Each begins with no names, in the folder that it is given. The kernel ends with the build.
"""

from __future__ import annotations

from typing import Any

from jupyter_cache.executors import utils
from jupyter_client import AsyncKernelManager
from nbclient import NotebookClient
from nbformat import NotebookNode

BEGIN = """
__import__("os").chdir({folder!r})
for _name in [each for each in globals() if each[0] != "_" and each not in get_ipython().user_ns_hidden]:
    del globals()[_name]
"""


def use() -> None:
    """Let myst-nb run what its cache does not have in a kernel that stays."""
    manager = AsyncKernelManager(kernel_name="python3")

    def execute(notebook: NotebookNode, cwd: str, **options: Any) -> NotebookNode:
        client = NotebookClient(notebook, km=manager, resources={"metadata": {"path": cwd}}, **options)

        def begin(notebook: NotebookNode) -> None:
            client.kc.execute(BEGIN.format(folder=cwd), silent=True, store_history=False)

        client.on_notebook_start = begin
        try:
            return client.execute()
        finally:
            client.kc.stop_channels()

    utils.executenb = execute
