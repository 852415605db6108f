#include "output/report_style.h"

#include "output/cards.h"

namespace saltus::internal {
namespace {

constexpr char kLight[] = R"(
  --paper: #ffffff; --ink: #24292f; --faint: #59636e; --line: #d8dee4; --raised: #f6f8fa; --link: #0550ae;
  --good: #116329; --good-paper: #dafbe1; --warning: #7d4e00; --warning-paper: #fff4cc;
  --bad: #a40e26; --bad-paper: #ffe2e0;
)";

constexpr char kDark[] = R"(
  --paper: #14181d; --ink: #e2e6ea; --faint: #9aa4af; --line: #333b45; --raised: #1c2128; --link: #79b8ff;
  --good: #7ee2a0; --good-paper: #12351f; --warning: #f0cf7a; --warning-paper: #3a2f0c;
  --bad: #ffaba8; --bad-paper: #481a1c;
)";

constexpr char kLayout[] = R"(
* { box-sizing: border-box; }
html { scroll-behavior: smooth; scroll-padding-top: 1rem; }
body { margin: 0; background: var(--paper); color: var(--ink); font: 16px/1.6 system-ui, -apple-system, "Segoe UI",
  Roboto, "Liberation Sans", Arial, sans-serif; -webkit-text-size-adjust: 100%; }
a { color: var(--link); text-decoration: none; }
a:hover { text-decoration: underline; }
main { max-width: 76rem; margin: 0 auto; padding: 2rem 1.25rem 5rem; min-width: 0; }
header { border-bottom: 1px solid var(--line); margin-bottom: 2rem; }
h1 { font-size: 2rem; line-height: 1.2; margin: 0 0 .5rem; letter-spacing: -.01em; }
h2 { font-size: 1.45rem; line-height: 1.3; margin: 3rem 0 .75rem; padding-bottom: .3rem;
  border-bottom: 1px solid var(--line); }
h3 { font-size: 1.12rem; line-height: 1.35; margin: 2rem 0 .5rem; }
h2 a, h3 a { color: inherit; }
.subtitle { color: var(--faint); margin: 0 0 1.25rem; }
p, li { max-width: 46rem; overflow-wrap: break-word; }
code, pre { font: .875em/1.5 ui-monospace, "SFMono-Regular", Menlo, Consolas, "Liberation Mono", monospace; }
code { background: var(--raised); border-radius: 4px; padding: .1em .3em; }
pre { background: var(--raised); border: 1px solid var(--line); border-radius: 8px; padding: .9rem 1rem;
  white-space: pre-wrap; overflow-wrap: anywhere; }
nav { font-size: .875rem; line-height: 1.4; padding: 1rem 1.25rem 0; max-width: 76rem; margin: 0 auto; }
nav ol { list-style: none; margin: .6rem 0 0; padding: 0; }
nav li { margin: .35rem 0; }
nav .level2 { padding-left: .9rem; }
nav .level2 a { color: var(--faint); }
summary { cursor: pointer; color: var(--faint); }
nav summary { font-weight: 600; }
@media (min-width: 76rem) {
  body { display: grid; grid-template-columns: 16rem minmax(0, 1fr); }
  nav { position: sticky; top: 0; align-self: start; height: 100vh; overflow-y: auto; margin: 0;
    padding: 2.25rem .75rem 2rem 1.5rem; border-right: 1px solid var(--line); }
  main { max-width: 76rem; width: 100%; padding: 2rem 2.5rem 5rem; }
  main:first-child { grid-column: 1 / -1; }
}
.tiles { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(16rem, 100%), 1fr)); gap: .75rem;
  margin: 1.25rem 0; }
.tile { min-width: 0; display: flex; flex-direction: column-reverse; justify-content: flex-end; background: var(--raised);
  border: 1px solid var(--line); border-left: 4px solid var(--line); border-radius: 8px; padding: .7rem .9rem; }
.tile dt { color: var(--faint); font-size: .85rem; line-height: 1.35; }
.tile dd { margin: 0; font-size: 1.5rem; font-weight: 650; line-height: 1.3; font-variant-numeric: tabular-nums;
  overflow-wrap: anywhere; }
.tile.good { border-left-color: var(--good); } .tile.good dd { color: var(--good); }
.tile.warning { border-left-color: var(--warning); } .tile.warning dd { color: var(--warning); }
.tile.bad { border-left-color: var(--bad); } .tile.bad dd { color: var(--bad); }
.tile.muted dd { color: var(--faint); }
.links a { display: inline-block; margin: 0 .4rem .4rem 0; padding: .15rem .7rem; border: 1px solid var(--line);
  border-radius: 999px; font-size: .875rem; }
figure { margin: 1.5rem 0 2rem; }
figcaption, figure summary { color: var(--faint); font-size: .9rem; line-height: 1.5; margin: .5rem 0; }
figcaption b, figure summary b { color: var(--ink); }
.plot { border: 1px solid var(--line); border-radius: 8px; padding: .5rem; overflow-x: auto; }
.plot svg { display: block; width: 100%; height: auto; }
.plots { container-type: inline-size; }
.plot.parts { display: none; }
.plot.parts svg.legend { display: inline-block; max-width: 100%; vertical-align: top; }
@container (max-width: 34rem) {
  .plots > .plot { display: none; }
  .plots > .plot.parts { display: block; }
}
.scroll { overflow: auto; border: 1px solid var(--line); border-radius: 8px; }
.scroll.tall { max-height: 80vh; }
table { border-collapse: separate; border-spacing: 0; width: 100%; font-size: .875rem; line-height: 1.4;
  font-variant-numeric: tabular-nums; }
th, td { padding: .42rem .75rem; text-align: left; vertical-align: top; border-bottom: 1px solid var(--line); }
td.long { min-width: 13rem; }
th { position: sticky; top: 0; background: var(--raised); font-weight: 600; z-index: 1; }
tbody tr:last-child td { border-bottom: 0; }
tbody tr:hover td:not(.good):not(.warning):not(.bad) { background: var(--raised); }
.number { text-align: right; }
td.number { white-space: nowrap; }
td.good { background: var(--good-paper); color: var(--good); }
td.warning { background: var(--warning-paper); color: var(--warning); }
td.bad { background: var(--bad-paper); color: var(--bad); font-weight: 600; }
td.muted { color: var(--faint); }
@media screen and (max-width: 48rem) {
  .scroll.rather-tall { max-height: 80vh; }
  table { font-size: .8rem; }
  th, td { padding: .3rem .4rem; }
  td.long { min-width: 9rem; }
}
@media print {
  nav { display: none; }
  body { display: block; font-size: 11pt; }
  main { max-width: none; padding: 0; }
  .scroll, .scroll.tall { max-height: none; overflow: visible; }
  th { position: static; }
  figure, tr { break-inside: avoid; }
  h2, h3 { break-after: avoid; }
}
)";

// Figures are drawn for white paper. On a dark screen light and dark change places and hues stay.
constexpr char kDarkPlots[] = R"(
.plot svg { filter: invert(1) hue-rotate(180deg); }
.plot svg > g > rect:first-child { fill: none; }
.plot.parts svg { mix-blend-mode: screen; }
)";

}  // namespace

std::string ReportStyle() {
  return std::string(":root {") + kLight + "}" + kLayout + CardsStyle() +
         "@media screen and (prefers-color-scheme: dark) {\n:root {" + kDark + "}" + kDarkPlots + "}\n";
}

}  // namespace saltus::internal
