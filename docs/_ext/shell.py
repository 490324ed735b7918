"""The cell magic ``%%sh`` for pages that the build runs: one output, in the order in which it was written.

IPython's own hands on pieces of a hundred characters, those of stderr apart. A copy of this file is run by each kernel
when it starts, see conf.py.
"""

import os
import subprocess

from IPython.core.magic import register_cell_magic

COLORS = ("FORCE_COLOR", "CLICOLOR_FORCE")
"""What a kernel asks commands for, and a page cannot show."""


@register_cell_magic
def sh(line: str, cell: str) -> None:
    """Run a cell with sh and print what it says; a failure is an error of the cell."""
    plain = {name: value for name, value in os.environ.items() if name not in COLORS}
    command = ["sh", *line.split(), "-c", cell]
    done = subprocess.run(command, env=plain, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    print(done.stdout, end="")
    done.check_returncode()
