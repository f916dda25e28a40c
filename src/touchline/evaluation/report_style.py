"""The stylesheet of report.html; the figures take their colours from its variables."""

STYLE = """
:root { color-scheme: light dark;
  --page:#fbfbf9; --card:#ffffff; --ink:#1d2320; --soft:#66706b; --grid:#e3e6e2; --line:#e3e6e2;
  --carpet:#e4efe2; --paint:#ffffff; --truth:#8f9a92; --tracking:#0b6e99; --searching:#d98a00; --lost:#c8324a;
  --bar:#4f7d6b; --series-x:#0b6e99; --series-y:#9a5b00; --series-heading:#7a4fa3; --warn:#fff2d6;
  --omnivision:#0b6e99; --both:#00a39b; --odometry:#c2269b; }
@media (prefers-color-scheme: dark) { :root {
  --page:#141816; --card:#1b201e; --ink:#e8ece9; --soft:#98a39d; --grid:#2c3330; --line:#2c3330;
  --carpet:#1f3a2a; --paint:#c9d8cc; --truth:#7d8a82; --tracking:#4fb6e3; --searching:#f0ae3d; --lost:#f2697d;
  --bar:#6fae96; --series-x:#4fb6e3; --series-y:#e0a04a; --series-heading:#b794dd; --warn:#3a2f14;
  --omnivision:#4fb6e3; --both:#3fd0c4; --odometry:#f07fd0; } }
* { box-sizing:border-box; }
body { margin:0; background:var(--page); color:var(--ink);
  font:16px/1.5 system-ui,-apple-system,"Segoe UI",Roboto,"Helvetica Neue",Arial,sans-serif; }
main { max-width:60rem; margin:0 auto; padding:2rem 1rem 3rem; }
.brand { margin:0; color:var(--soft); font-size:.8rem; letter-spacing:.12em; text-transform:uppercase; }
h1 { margin:.1rem 0 .2rem; font-size:1.9rem; line-height:1.2; font-weight:650; overflow-wrap:anywhere; }
h2 { margin:0 0 .6rem; font-size:1.05rem; font-weight:600; }
.facts { margin:0; color:var(--soft); } .facts strong { color:var(--ink); font-weight:600; }
.description { margin:.5rem 0 0; max-width:46rem; }
.warning { background:var(--warn); padding:.6rem .9rem; border-radius:.5rem; }
section, .tile { background:var(--card); border:1px solid var(--line); border-radius:.7rem; }
section { margin-top:1rem; padding:1.1rem 1.2rem; }
.tiles { display:grid; grid-template-columns:repeat(auto-fit,minmax(min(45%,13rem),1fr)); gap:.7rem;
  margin:1.4rem 0 0; }
.tile { padding:.7rem .9rem; }
.tile dt { color:var(--soft); font-size:.82rem; }
.tile dd { margin:0; font-size:1.6rem; font-weight:600; font-variant-numeric:tabular-nums; }
.tile dd span { font-size:.9rem; font-weight:400; color:var(--soft); }
.scroll { overflow-x:auto; }
table { border-collapse:collapse; width:100%; font-size:.92rem; font-variant-numeric:tabular-nums; }
th, td { padding:.35rem .7rem; border-bottom:1px solid var(--line); text-align:left; font-weight:400; }
.errors th, .errors td { white-space:nowrap; }
.errors td, .errors thead th { text-align:right; }
thead th { color:var(--soft); font-size:.82rem; }
tbody tr:last-child > * { border-bottom:0; }
.note, figcaption { margin:.6rem 0 0; color:var(--soft); font-size:.85rem; }
figure { margin:0; }
figure svg { display:block; width:100%; min-width:30rem; height:auto; }
svg * { stroke-linejoin:round; stroke-linecap:butt; }
.gallery { display:grid; grid-template-columns:repeat(auto-fit,minmax(min(100%,25rem),1fr)); gap:1rem; }
.gallery img { display:block; width:100%; height:auto; border-radius:.4rem; background:#181818; }
.gallery figcaption strong { color:var(--ink); font-weight:600; }
@media (max-width:34rem) { section { padding:.9rem .8rem; } th, td { padding:.35rem .3rem; font-size:.85rem; }
  figure svg { min-width:26rem; } }
.key { display:inline-block; width:.7em; height:.7em; border-radius:50%; margin:0 .3em 0 .5em; }
.key.tracking { background:var(--tracking); margin-left:0; } .key.searching { background:var(--searching); }
.key.lost { background:var(--lost); } .key.truth { background:var(--truth); opacity:.5; }
.key.omnivision { background:var(--omnivision); } .key.both { background:var(--both); }
.key.odometry { background:var(--odometry); } .key.first-located { border:1.5px solid var(--ink); }
.keys { display:flex; flex-wrap:wrap; gap:.1rem 1.1rem; margin-bottom:.4rem; color:var(--ink); }
.keys > span { white-space:nowrap; } .keys .key { margin-left:0; }
summary { cursor:pointer; } details[open] summary { margin-bottom:.5rem; }
ul, ol { margin:.2rem 0; padding-left:1.4rem; } .small { font-size:.88rem; }
footer { margin-top:1.4rem; color:var(--soft); font-size:.8rem; }
"""
