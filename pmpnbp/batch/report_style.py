"""How does the report look? The page's colours, light and dark by what the reader's system asks; no scripts."""

from __future__ import annotations

STYLE = """
:root {
  color-scheme: light dark;
  --ground: #f3f4f6; --sheet: #ffffff; --line: #dcdfe4; --ink: #1f2630; --quiet: #59626f; --accent: #345bb5;
  --good: #1d6f4f; --fair: #8a5310; --bad: #a83620;
}
@media (prefers-color-scheme: dark) {
  :root {
    --ground: #12161b; --sheet: #1a2027; --line: #2e3742; --ink: #e8ebef; --quiet: #9ba6b4; --accent: #8fb0ff;
    --good: #58c79b; --fair: #f0b25a; --bad: #ff8f76;
  }
  img { filter: brightness(0.85); }
}
* { box-sizing: border-box; }
body {
  margin: 0; background: var(--ground); color: var(--ink);
  font: 15px/1.5 system-ui, sans-serif; font-variant-numeric: tabular-nums;
}
main { max-width: 90rem; margin: 0 auto; padding: clamp(1rem, 4vw, 3rem); }
h1 { margin: 0; font-size: 1.6rem; letter-spacing: -0.015em; overflow-wrap: anywhere; }
h2 { margin: 2.4rem 0 0.9rem; font-size: 1.15rem; }
h3 { margin: 0; font-size: 1rem; overflow-wrap: anywhere; }
p { margin: 0.3rem 0; overflow-wrap: anywhere; }
a { color: var(--accent); text-underline-offset: 0.18em; }
:focus-visible { outline: 2px solid var(--accent); outline-offset: 3px; border-radius: 4px; }
.quiet { color: var(--quiet); }
.counts { display: flex; flex-wrap: wrap; gap: 0.6rem; margin: 1.2rem 0; padding: 0; list-style: none; }
.counts a {
  display: block; min-width: 7.5rem; padding: 0.6rem 0.9rem; border: 1px solid var(--line);
  border-radius: 8px; background: var(--sheet); color: var(--ink); text-decoration: none;
}
.counts b { display: block; font-size: 1.35rem; }
.rows {
  display: grid; grid-template-columns: repeat(auto-fill, minmax(min(100%, 19rem), 1fr));
  gap: 1rem; margin: 0; padding: 0; list-style: none;
}
.rows > li {
  overflow: hidden; border: 1px solid var(--line); border-radius: 10px; background: var(--sheet);
}
.rows img { display: block; width: 100%; height: auto; background: var(--ground); }
.about { padding: 0.8rem 1rem 1rem; }
.error h2, .not-found h2, .error b, .not-found b { color: var(--bad); }
.no-verdict h2, .doubtful h2, .no-verdict b, .doubtful b { color: var(--fair); }
.found h2, .certain h2, .found b, .certain b { color: var(--good); }
dl { display: grid; grid-template-columns: minmax(0, 1fr) fit-content(72%); gap: 0.1rem 0.8rem; margin: 0.6rem 0; }
dt { color: var(--quiet); overflow-wrap: anywhere; }
dd { margin: 0; text-align: right; overflow-wrap: anywhere; }
summary { cursor: pointer; color: var(--accent); }
@media print { .rows > li { break-inside: avoid; } }
"""
