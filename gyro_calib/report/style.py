"""Style sheet of the report page."""

__all__ = ["STYLE"]

STYLE = """\
:root {
  --font: system-ui, -apple-system, "Segoe UI", Roboto, "Noto Sans", "DejaVu Sans", sans-serif;
  --page: #f5f6f8; --card: #ffffff; --ink: #1b1f24; --muted: #59636e; --grid: #e3e6ea; --line: #dfe3e8;
  --s1: #1f6feb; --s2: #d1670a; --s3: #0f8a6a; --s4: #8250c4; --good: #0f8a6a; --bad: #c4352b;
}
@media (prefers-color-scheme: dark) {
  :root {
    --page: #0f1216; --card: #171b21; --ink: #e8ebef; --muted: #98a3b0; --grid: #2a3038; --line: #2a3038;
    --s1: #6aa8ff; --s2: #f29a4a; --s3: #3fc79e; --s4: #b794f6; --good: #3fc79e; --bad: #ff7b72;
  }
}
* { box-sizing: border-box; }
html { -webkit-text-size-adjust: 100%; }
body { margin: 0; background: var(--page); color: var(--ink); font: 16px/1.5 var(--font); }
main { max-width: 1120px; margin: 0 auto; padding: 40px 24px 56px; }
h1 { margin: 0; font-size: 30px; line-height: 1.2; letter-spacing: -0.015em; font-weight: 650; text-wrap: balance; }
h2 { margin: 0; font-size: 15px; line-height: 1.35; font-weight: 600; }
p { margin: 0; }
.kind { color: var(--muted); font-size: 14px; margin-bottom: 4px; }
.subtitle { color: var(--muted); margin-top: 6px; max-width: 75ch; }
.verdict { margin-top: 24px; padding: 14px 18px; border-left: 4px solid var(--muted); border-radius: 4px; background: var(--card);
  font-size: 18px; line-height: 1.45; text-wrap: pretty; }
.verdict.good { border-color: var(--good); }
.verdict.bad { border-color: var(--bad); }
.tiles, .panels { display: grid; gap: 16px; margin-top: 16px; }
.tiles { grid-template-columns: repeat(auto-fit, minmax(230px, 1fr)); }
.panels { grid-template-columns: repeat(2, minmax(0, 1fr)); }
.tile, .panel, .table, details, .notes { background: var(--card); border: 1px solid var(--line); border-radius: 10px; }
.tile { padding: 16px 18px; }
.tile h2 { color: var(--muted); font-weight: 500; font-size: 14px; }
.figure { margin: 2px 0 4px; font-size: 26px; line-height: 1.3; font-weight: 650; letter-spacing: -0.01em;
  font-variant-numeric: tabular-nums; }
.note { color: var(--muted); font-size: 14px; }
.panel { margin: 0; padding: 16px 18px 14px; display: flex; flex-direction: column; }
.panel:last-child:nth-child(odd) { grid-column: 1 / -1; }
.panel:last-child:nth-child(odd) .plot { width: 100%; max-width: 540px; margin-inline: auto; }
.plot { margin: 8px -6px 4px; flex: 1; }
.plot svg { display: block; width: 100%; height: auto; }
figcaption { color: var(--muted); font-size: 14px; line-height: 1.45; }
.notes, .table, details { margin-top: 16px; padding: 16px 18px; }
.notes ul { margin: 8px 0 0; padding-left: 20px; color: var(--muted); font-size: 15px; }
.notes li + li { margin-top: 4px; }
summary { cursor: pointer; font-size: 15px; font-weight: 600; }
.scroll { overflow-x: auto; margin-top: 10px; }
table { border-collapse: collapse; width: 100%; font-size: 14px; font-variant-numeric: tabular-nums; }
th, td { padding: 6px 14px 6px 0; text-align: right; border-top: 1px solid var(--line); white-space: nowrap; }
thead th { border-top: 0; color: var(--muted); font-weight: 500; }
th:first-child { text-align: left; font-weight: 500; }
td.words, th.words { text-align: left; }
td.words { white-space: normal; }
tr > :last-child { padding-right: 0; }
.table .note, details .note { margin-top: 10px; }
footer { margin-top: 24px; color: var(--muted); font-size: 13px; overflow-wrap: anywhere; }
@media screen and (max-width: 760px) {
  main { padding: 24px 14px 40px; }
  h1 { font-size: 24px; }
  .verdict { font-size: 16px; padding: 12px 14px; }
  .panels { grid-template-columns: minmax(0, 1fr); gap: 12px; }
  .tiles { grid-template-columns: repeat(auto-fit, minmax(150px, 1fr)); gap: 12px; }
  .tile, .panel, .notes, .table, details { padding: 12px 14px; }
  .figure { font-size: 21px; }
  .plot { margin-inline: -12px; }
  table { font-size: 13px; }
  th, td { padding-right: 10px; }
  th { white-space: normal; }
  tbody th { min-width: 7.5em; }
  td.words { min-width: 9em; }
}
@media print {
  @page { margin: 14mm; }
  :root { --page: #ffffff; --card: #ffffff; --ink: #1b1f24; --muted: #454c54; --grid: #e3e6ea; --line: #c9ced5;
    --s1: #1f6feb; --s2: #d1670a; --s3: #0f8a6a; --s4: #8250c4; --good: #0f8a6a; --bad: #c4352b; }
  body { font-size: 11pt; }
  main { max-width: none; padding: 0; }
  .tile, .panel, .notes, tr { break-inside: avoid; }
  h2, summary, thead { break-after: avoid; }
  .scroll { overflow: visible; }
  table { font-size: 9pt; }
  th, td { padding: 3px 8px 3px 0; white-space: normal; }
  .panels { gap: 12px; }
  .tiles { grid-template-columns: repeat(4, 1fr); }
  .figure { font-size: 18px; }
  details::details-content { display: block; content-visibility: visible; height: auto; }
}
"""
