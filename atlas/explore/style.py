"""The style sheets of the page. In dark mode all colours are inverted, except those of the map and its legend.

A page at least three columns wide has the plane between its controls and the details of cells. On a narrower page, as
in a notebook, the plane takes the whole width, and both columns stand below. On a phone everything is in one column.
"""

KEY_WIDTH = 190
"""Width, in pixels, of the legend beside a plane."""
RIGHT_MARGIN, TOOLBAR = 12, 30
"""Distance between a plane and its legend, and width of the toolbar to the right of a plot, in pixels."""
CUT_HEIGHT = "min(330px, 45vh)"
STACKED, SINGLE = "(max-width: 1279px)", "(max-width: 639px)"
"""Media queries: widths of a page with the plane above both columns, and of a page with a single column."""

CUTTING = "cutting"
"""CSS class of the middle column while it shows a cut."""

PAGE = f"""
html, body {{ height: 100%; margin: 0; overflow: hidden; background: #fff; font-family: system-ui, sans-serif; }}
body > div:not(.bk-Notifications) {{ height: 100%; }}
@media (prefers-color-scheme: dark) {{ html {{ filter: invert(1); background: #fff; }} }}
@media {STACKED} {{
  html {{ overflow: hidden auto; height: auto; }} body {{ overflow: visible; height: auto; }}
  body > div:not(.bk-Notifications) {{ height: auto; }}
}}
"""

WHOLE = f"""
@media {STACKED} {{
  :host {{ display: grid !important; height: auto !important; gap: 0;
          grid-template-columns: minmax(0, 2fr) minmax(0, 3fr); align-items: start; }}
}}
@media {SINGLE} {{ :host {{ grid-template-columns: minmax(0, 1fr); }} }}
"""

MIDDLE = f"""
@media {STACKED} {{
  :host {{ grid-column: 1 / -1; order: -1; width: auto !important;
          height: min(84vh, 75vw) !important;
          min-height: 340px; }}
  :host(.{CUTTING}) {{ height: calc(min(84vh, 75vw) + {CUT_HEIGHT}) !important; }}
}}
@media {SINGLE} {{ :host, :host(.{CUTTING}) {{ height: auto !important; }} }}
"""

PANE = f"""
@media {SINGLE} {{ :host {{ width: 100% !important; height: auto !important; flex: none !important; }} }}
"""

PLANE = f"""
@media {SINGLE} {{ :host {{ flex-direction: column !important; height: auto !important; flex: none !important; }} }}
"""

FOLD = f"""
:host {{ display: none !important; }}
@media {SINGLE} {{ :host {{ display: block !important; }} }}
"""
"""The button that unfolds the controls on a phone, between the plane and the details of a cell."""

POINTER = f"""
@media (hover: none) {{ :host {{ display: none !important; }} }}
@media {SINGLE} {{ :host {{ order: 1; }} }}
"""
"""The cell under the pointer: below the clicked cell in a single column, and hidden on touch screens."""

BAR = """
div[role=progressbar] { height: 3px; background: #1f5fa8; margin-left: 76px; max-width: calc(100% - 76px); }
"""

FOCUS = """
:focus-visible { outline: 3px solid #1f5fa8 !important; outline-offset: 1px; }
@media (pointer: coarse) { .bk-btn, input:not([type=checkbox]), select { min-height: 38px; } }
"""

TEXT = (
    """
:host { font: 12.5px/1.45 system-ui, sans-serif; color: #1a2433; }
table { font-size: 12px; line-height: 1.3; }
b { font-size: 14px; } i { font-family: Georgia, "Times New Roman", serif; font-size: 14px; }
h4 { margin: 8px 0 2px; font-size: 12.5px; color: #5a6675; font-weight: 600; }
table { border-collapse: collapse; width: 100%; } caption { text-align: left; color: #5a6675; padding-bottom: 2px; }
td { padding: 0 4px 0 0; vertical-align: top; font-variant-numeric: tabular-nums; }
td:first-child { color: #5a6675; } .number { white-space: nowrap; }
pre { white-space: pre-wrap; word-break: break-all; background: #f3f5f8; padding: 6px; margin: 4px 0; }
pre { font-size: 11.5px; }
table.list td:first-child { width: 12px; } table.list td { white-space: nowrap; }
th { text-align: left; font-weight: 400; color: #5a6675; } .waiting { color: #5a6675; }
@media (prefers-color-scheme: dark) { img { filter: invert(1); } }
.trouble { color: #b3261e; font-weight: 600; } img { max-width: 100%; }
"""
    + FOCUS
)

PLOT = f"""
.bk-Canvas:hover {{ --outline-width: 0px; }}
@media {SINGLE} {{ :host {{ flex: none !important; width: 100% !important; height: 100vw !important; }} }}
"""

PANEL = f"""
:host {{ overflow-y: auto; overflow-x: hidden; padding: 0 6px; box-sizing: border-box; }}
@media {STACKED} {{ :host {{ overflow: visible; width: auto !important; height: auto !important; }} }}
@media {SINGLE} {{ :host(.folded) {{ display: none !important; }} }}
"""

CUT = f"""
:host {{ flex: none !important; height: {CUT_HEIGHT} !important; box-sizing: border-box;
        padding-right: {KEY_WIDTH + RIGHT_MARGIN - TOOLBAR}px; }}
@media {SINGLE} {{ :host {{ width: 100% !important; height: auto !important; padding-right: 0; }} }}
"""
"""The diagrams of a cut. They end where the plane does: beside the plane is the legend, beside the diagrams the
toolbar.
"""

CUT_HEAD = f"""
@media {SINGLE} {{
  :host {{ display: grid !important; grid-template-columns: auto 1fr; height: auto !important; }}
  :host > div:nth-of-type(-n + 2) {{ grid-column: 1 / -1; }}
}}
"""

DIAGRAM = f"@media {SINGLE} {{ :host {{ flex: none !important; width: 100% !important; height: 170px !important; }} }}"

LINE = f"""
:host {{ overflow: hidden; white-space: nowrap; text-overflow: ellipsis; }}
:host > div {{ overflow: hidden; text-overflow: ellipsis; }}
@media {SINGLE} {{ :host {{ flex: none !important; height: auto !important; white-space: normal; }} }}
"""

KEY = f"""
:host {{ overflow: hidden auto; padding-left: 6px; box-sizing: border-box; }}
:host > div {{ width: 100%; }}
.key {{ display: block; font-size: 12px; line-height: 1.3; }}
.key h2 {{ font-size: 12.5px; }}
.key input[type=number] {{ width: 4.6rem; }}
.key input[type=number], .key button {{ font: inherit; padding: 2px 4px; min-height: 24px; box-sizing: border-box; }}
.key .ends {{ gap: 4px; }} .key label {{ min-height: 22px; }}
{FOCUS}
@media (prefers-color-scheme: dark) {{ canvas {{ filter: invert(1); }} }}
@media {SINGLE} {{ :host {{ flex: none !important; height: auto !important; width: auto !important; }} }}
"""
"""The legend of a map beside the plane, or below it on a phone; its colours are not inverted."""

LOOK = """
:host > div { width: 100%; } .look { display: block; } .look h4 { margin-top: 4px; }
label { display: flex; gap: 6px; align-items: center; min-height: 22px; }
label.map { margin-bottom: 4px; } select { flex: 1; width: 0; min-width: 0; font: inherit; padding: 0 4px; }
@media (pointer: coarse) { label { min-height: 38px; } }
"""
"""The menus and switches for the style of a plane."""
