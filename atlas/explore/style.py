"""The looks of the page, as CSS."""

PAGE = """
html, body { height: 100%; margin: 0; overflow: hidden; background: #fff; font-family: system-ui, sans-serif; }
body > div { height: 100%; }
"""

TEXT = """
:host { font: 12.5px/1.45 system-ui, sans-serif; color: #1a2433; }
table { font-size: 12px; line-height: 1.3; }
b { font-size: 14px; } i { font-family: Georgia, "Times New Roman", serif; font-size: 14px; }
h4 { margin: 8px 0 2px; font-size: 12.5px; color: #5a6675; font-weight: 600; }
table { border-collapse: collapse; width: 100%; } caption { text-align: left; color: #5a6675; padding-bottom: 2px; }
td { padding: 0 4px 0 0; vertical-align: top; font-variant-numeric: tabular-nums; }
td:first-child { color: #5a6675; white-space: nowrap; } td + td { word-break: break-all; }
pre { white-space: pre-wrap; word-break: break-all; background: #f3f5f8; padding: 6px; margin: 4px 0; }
pre { font-size: 11.5px; }
table.list td:first-child { width: 12px; } table.list td { white-space: nowrap; word-break: normal; }
th { text-align: left; font-weight: 400; color: #5a6675; } .waiting { color: #5a6675; }
.trouble { color: #b3261e; font-weight: 600; } img { max-width: 100%; }
"""

PLOT = """
.bk-Canvas:hover { --outline-width: 0px; }
"""

PANEL = """
:host { overflow-y: auto; overflow-x: hidden; padding: 0 6px; box-sizing: border-box; }
"""

LINE = """
:host { overflow: hidden; white-space: nowrap; text-overflow: ellipsis; }
:host > div { overflow: hidden; text-overflow: ellipsis; }
"""

KEY = """
:host { position: relative; overflow: hidden; } img { position: absolute; left: 0; top: 0; max-width: none; }
"""
