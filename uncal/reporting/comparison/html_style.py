"""How the page looks, on a screen and on paper."""

from __future__ import annotations

STYLE = """
:root { color-scheme: light; }
body { margin: 1.5rem auto; max-width: 74rem; padding: 0 1rem; background: #fff; color: #1a1a1a;
  font: 15px/1.45 system-ui, "Segoe UI", "DejaVu Sans", sans-serif; }
h1 { font-size: 1.6rem; line-height: 1.2; margin: 0 0 .3rem; }
h2 { font-size: 1.25rem; margin: 2rem 0 .5rem; border-bottom: 1px solid #bbb; }
h3 { font-size: 1rem; margin: 1.4rem 0 .4rem; }
nav { font-size: .9rem; margin: 1rem 0; }
a { color: #00527a; }
.notice { margin: 1rem 0; padding: .8rem 1.2rem; background: #fff6e0; border: 2px solid #b35c00; }
.notice h2 { margin: 0 0 .4rem; border: 0; color: #7a3e00; }
.notice p { margin: .3rem 0; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; font-size: .8rem; font-variant-numeric: tabular-nums; }
th, td { padding: .18rem .42rem; vertical-align: top; text-align: left; font-weight: normal; }
thead th { font-weight: 600; border-bottom: 1px solid #1a1a1a; vertical-align: bottom; }
thead th[colspan] { text-align: center; border-bottom: 0; }
th.number, td.number { text-align: right; }
td.number { white-space: nowrap; }
th.begins, td.begins { padding-left: .9rem; }
tbody { border-bottom: 1px solid #bbb; }
.sources tbody th { min-width: 9rem; max-width: 16rem; }
tbody.published { background: #eef3f8; }
tbody.run th { font-weight: 600; }
ul.notes, ul.made { margin: .4rem 0; padding-left: 1.1rem; font-size: .8rem; color: #333; }
ul.made { list-style: none; padding-left: 0; }
ul.made li { padding-left: 1.1rem; text-indent: -1.1rem; }
.made { font: .75rem/1.4 ui-monospace, "DejaVu Sans Mono", monospace; color: #555;
  overflow-wrap: anywhere; }
figure { margin: 1rem 0; }
figure img { max-width: 100%; height: auto; object-fit: contain; object-position: left; }
figcaption p { margin: .3rem 0; font-size: .85rem; max-width: 50rem; }
@page { size: A4 landscape; margin: 11mm; }
@media print {
  :root { font-size: 8.5pt; }
  body { max-width: none; margin: 0; padding: 0; font-size: 1rem; }
  nav { display: none; }
  .scroll { overflow: visible; }
  table.short { break-inside: avoid; }
  figure img { max-height: 150mm; }
  table.wide { font-size: .74rem; }
  th, td { padding: .1rem .28rem; }
  th.begins, td.begins { padding-left: .5rem; }
  h2, h3 { break-after: avoid; }
  tbody, figure, .notice { break-inside: avoid; }
  tbody.published, .notice { print-color-adjust: exact; -webkit-print-color-adjust: exact; }
}
"""
