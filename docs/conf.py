"""How Sphinx builds the site: ``scripts/docs``. Everything a page needs is in the site; nothing is fetched."""

import atexit
import os
import shutil
import sys
import tempfile
from importlib.metadata import version as installed
from pathlib import Path

DOCS = Path(__file__).parent
sys.path[:0] = [str(DOCS / "_ext"), str(DOCS.parent)]

# The kernels of notebooks: nothing of the user's own settings, and the magic of these pages.
KERNELS = tempfile.mkdtemp()
atexit.register(shutil.rmtree, KERNELS, ignore_errors=True)
STARTUP = Path(KERNELS) / "profile_default/startup"
STARTUP.mkdir(parents=True)
shutil.copy(DOCS / "_ext/shell.py", STARTUP / "00-shell.py")
os.environ["IPYTHONDIR"] = KERNELS

project = "impact-atlas"
author = "impact-atlas contributors"
copyright = author
version = release = installed("impact-atlas")

extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx_click", "cells", "docstrings", "formulas", "modules", "tables"]
exclude_patterns = ["_ext"]
templates_path = ["_templates"]
highlight_language = "text"
nitpicky = False
suppress_warnings = [
    "config.cache",  # myst-nb keeps a function in its configuration
    "myst-nb.lexer",  # of notebooks that are not run while one writes
]

myst_enable_extensions = ["amsmath", "colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 4
myst_links_external_new_tab = False

# Pages that are notebooks are run by the build, in a temporary folder each: what they show is what happens.
nb_execution_mode = "force"
nb_execution_in_temp = True
nb_execution_timeout = 300
nb_execution_raise_on_error = True
nb_execution_show_tb = True
nb_merge_streams = True
nb_code_prompt_show = "Show the file or the commands"
nb_code_prompt_hide = "Hide them"

autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
python_maximum_signature_line_length = 88
add_module_names = False

html_theme = "pydata_sphinx_theme"
html_title = "impact-atlas"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_math_renderer = "drawn"
html_sidebars = {"**": ["contents"], "gallery": [], "index": []}
html_show_sourcelink = False
html_copy_source = False
html_theme_options = {
    "navbar_align": "left",
    "navbar_center": [],  # the sidebar has the contents
    "show_toc_level": 2,
    "navigation_with_keys": False,
    "show_prev_next": True,
    "footer_start": ["copyright"],
    "footer_end": [],
    "back_to_top_button": False,
    "pygments_light_style": "a11y-high-contrast-light",
    "pygments_dark_style": "a11y-high-contrast-dark",
}
