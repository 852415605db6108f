#!/usr/bin/python3
# usage: engines/report.py STUDY.json OUTPUT.html [--tasks=FILE.csv] [--picture=FILE.svg]
# A page of what engines/study.py and engines/tasks.py measured, and one figure of it for the README.
import argparse
import html
import json
import pathlib

from check import HERE, engines, how_to_get
from figures import class_diagram, error_by_step, error_by_width, scans
from page_table import cell, style, table
from task_table import percent, task_summary, task_table
from tasks import read as read_tasks
from verdict import gradient_errors, loss_errors, of_contact, of_gradient, of_motion, relative_error

STYLE = """
:root { --paper: #ffffff; --ink: #24292f; --faint: #59636e; --line: #d8dee4; --raised: #f6f8fa; --good: #116329;
  --good-paper: #dafbe1; --bad: #a40e26; --bad-paper: #ffe2e0; --warning: #7d4e00; --warning-paper: #fff4cc;
  --curve: #0550ae; --impact-time: #0a8a5f; --force: #7c117d; --projection: #0a8fc7; --impulse: #db7549;
  --depth: #a40e26; --unclear: #6e7781; }
@media (prefers-color-scheme: dark) { :root { --paper: #14181d; --ink: #e2e6ea; --faint: #9aa4af; --line: #333b45;
  --raised: #1c2128; --good: #7ee2a0; --good-paper: #12351f; --bad: #ffaba8; --bad-paper: #481a1c; --warning: #f0cf7a;
  --warning-paper: #3a2f0c; --curve: #79b8ff; --impact-time: #3ddc97; --force: #e08be0; --projection: #5cc4f5;
  --impulse: #f0946b; --depth: #ff7b86; --unclear: #9aa4af; } }
* { box-sizing: border-box; }
body { margin: 0; background: var(--paper); color: var(--ink); font: 16px/1.6 system-ui, "Liberation Sans", sans-serif; }
main { max-width: 80rem; margin: 0 auto; padding: 2rem 1.25rem 5rem; }
h1 { font-size: 2rem; line-height: 1.2; margin: 0 0 .5rem; }
h2 { font-size: 1.4rem; margin: 3rem 0 .75rem; border-bottom: 1px solid var(--line); }
p { max-width: 48rem; }
code { background: var(--raised); border-radius: 4px; padding: .1em .3em; font-size: .875em; }
.scroll { overflow-x: auto; border: 1px solid var(--line); border-radius: 8px; }
table { border-collapse: collapse; width: 100%; font-size: .82rem; line-height: 1.4; font-variant-numeric: tabular-nums; }
th, td { padding: .4rem .6rem; text-align: left; vertical-align: top; border-bottom: 1px solid var(--line); }
th { background: var(--raised); }
.number { text-align: right; white-space: nowrap; }
.good { background: var(--good-paper); color: var(--good); }
.bad { background: var(--bad-paper); color: var(--bad); font-weight: 600; }
.warning { background: var(--warning-paper); color: var(--warning); }
.faint { color: var(--faint); }
.class { min-width: 11rem; }
.tasks .faint { font-weight: normal; }
.panels { display: grid; grid-template-columns: repeat(auto-fill, minmax(14rem, 1fr)); gap: .5rem; }
.panels svg, figure svg { width: 100%; height: auto; }
figure { margin: 1rem 0; max-width: 60rem; container-type: inline-size; }
.narrow { display: none; }
@container (max-width: 40rem) { .plot { display: none; } .plot.narrow { display: block; } }
"""
CARDS_BELOW = {"verdicts": 68, "tasks": 44}  # rem
SHADES = {"right": "good", "consistent": "good", "converges": "good", "wrong": "bad", "wrong sign": "bad",
          "does not converge": "bad"}


HEADS = ["engine", "loss", "motion", "gradient", "error", "error, {steps} steps", "error, width 0.01", "verdict", "class",
         "e", "keep", "feed", "oblique impact"]


def row_of(row, study, exact):
    precision = ", float32" if row["precision"] == "float32" else ""
    name = cell(f'{html.escape(row["engine"])}<br><span class="faint">{html.escape(row["licence"])}{precision}</span>')
    if study is None:
        return [name, cell(f"not measured; to be had by <code>{html.escape(how_to_get(row))}</code>", "faint")]
    if "failed" in study:
        return [name, cell(html.escape(study["failed"]), "warning")]
    verdict = of_gradient(study, exact, row["precision"] == "float32")
    motion = of_motion(study, exact)
    loss, gradient = study["by_step"]["480"]
    errors = [relative_error(gradient, exact["gradient"]), gradient_errors(study, exact)[-1],
              relative_error(study["by_width"]["0.01"], exact["gradient"])]
    both = [study["impact"]["240"], study["impact"]["2400"]]
    oblique = study["oblique"]
    return [name, cell(f"{loss:.4f}", "number"), cell(motion, SHADES[motion]), vector_cell(gradient),
            *(cell(percent(error), "number") for error in errors),
            cell(verdict, SHADES[verdict]), cell(html.escape(of_contact(study)), "class"),
            *(cell("<br>".join(f"{impact[key]:.3f}" if isinstance(impact, dict) else "?" for impact in both), "number")
              for key in ("e", "keep", "feed")),
            cell(html.escape(oblique), "faint") if isinstance(oblique, str) else
            cell(f"{oblique[0]:.2f}, {oblique[1]:.2f}", "number")]


def vector_cell(vector):
    return cell("<br>".join(f"{entry:.4f}" for entry in vector), "number")


def verdict_table(rows, studies, exact, known_steps):
    heads = [head.format(steps=known_steps) for head in HEADS]
    first = [cell("exact"), cell(f'{exact["loss"]:.4f}', "number"), cell(""), vector_cell(exact["gradient"])]
    first += [cell("")] * (len(heads) - len(first))
    return table(heads, [first] + [row_of(row, studies.get(row["id"]), exact) for row in rows], "verdicts")


def summary(rows, studies, exact):
    verdicts = [of_gradient(studies[row["id"]], exact, row["precision"] == "float32") for row in rows]
    boundary = [row for row in rows if of_contact(studies[row["id"]]).startswith("impulse at a step boundary")]
    right = [row["engine"] for row, verdict in zip(rows, verdicts) if verdict == "right"]
    bad_motion = [row["engine"] for row in rows if of_motion(studies[row["id"]], exact) != "converges"]
    return (f"<p>{len(rows)} configurations were measured. Right: {html.escape(', '.join(right)) or 'none'}. "
            f"{len(boundary)} apply the impulse at a step boundary. The motion itself does not converge in "
            f"{html.escape(', '.join(bad_motion)) or 'none'}.</p>")


# What was found of each engine on each task; empty without such a table.
def all_tasks(rows, found):
    if not found:
        return ""
    return f"""<h2>All tasks</h2>
<p>Verdict, by the gradient at 1, 2, 4 and 8 times the steps of the task (<code>engines/tasks.py --check</code> has
<code>saltus_audit --simulate</code> judge them too); the error of the loss, at the task's own steps, and whether it goes to
0 with finer ones; the error of the gradient by the start of the first disc, by differences narrower and wider than what
moves in a step. On task 1 the ball strikes the ground exactly between two steps: engines jump there, and narrow
differences see the jump. {html.escape(task_summary(found))}</p>
{task_table(rows, found)}
"""


# As wide as the page, and another one for screens on which its words would be too small.
def figure(draw, rows, known):
    return (f'<figure><div class="plot">{draw(rows, known)}</div>'
            f'<div class="plot narrow">{draw(rows, known, narrow=True)}</div></figure>')


def page(known, rows, tasks):
    studies, exact = known["engines"], known["exact"]
    measured = [row for row in rows if "by_step" in studies.get(row["id"], {})]
    panels = "".join(f"<div>{panel}</div>" for panel in scans(measured, known))
    return f"""<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<title>Simulators, audited</title>
<link rel="icon" href="data:,">
<meta name="color-scheme" content="light dark"><style>{STYLE}{style(CARDS_BELOW)}</style></head><body><main>
<h1>Simulators, audited</h1>
<p>Task 3: one ball is pushed so that it strikes another towards the origin, without friction or loss; 480 steps. Each
engine runs as a black box: nothing is known of it but where the balls end. Sleep and damping are off, restitution is 1,
all else is as shipped.</p>
{summary(measured, studies, exact)}
<h2>Verdicts</h2>
<p>Gradient: of the loss by the start of both balls along x (striker, target) and their velocities along x, by central
differences of width 1e-6, or 1e-4 where the engine computes in float32, whose noise hides smaller ones. Errors are
those of the gradient, relative to the exact one. Verdict: by the errors at {", ".join(map(str, known["steps"]))} steps.
Class: from a head-on impact at 3 m/s, seen from outside, at 240 and 2400 steps: <code>e</code> is the rebound,
<code>keep</code> what is left of a displacement just after the impact (exact: -1), <code>feed</code> the share of the depth
that a step gives back as velocity. Last column: a disc strikes a tilted plane at 3 m/s, with restitution 0.5 and friction
0.2; it should rebound at 1.5 m/s and go on along the plane at 3.1 m/s.</p>
{verdict_table(rows, studies, exact, known["steps"][-1])}
{all_tasks(rows, tasks)}<h2>The loss, from one start to the next</h2>
<p>Loss against the start of the striker, -2 +- 0.02 m; grey is exact. The gradient is the slope: where a curve is a
staircase, the slope of the stairs is what differences at a small width and automatic differentiation see.</p>
<div class="panels">{panels}</div>
<h2>Error against step</h2>
<p>Of the gradient, by differences at the smallest width that the precision allows.</p>
{figure(error_by_step, measured, known)}
<h2>Error against width</h2>
<p>At 480 steps. The striker moves 6 mm in a step: differences wider than that look across the stairs.</p>
{figure(error_by_width, measured, known)}
<h2>Class</h2>
<p>Of a displacement before the impact: what is left just after (<code>keep</code>), and what of it is fed back to the
velocity in a step (<code>feed</code>), at 240 steps (small) and 2400 (large).</p>
{figure(class_diagram, measured, known)}
</main></body></html>
"""


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("study", type=pathlib.Path)
    parser.add_argument("output", type=pathlib.Path)
    parser.add_argument("--tasks", type=pathlib.Path, help="the table of engines/tasks.py")
    parser.add_argument("--picture", type=pathlib.Path, help="write the scans of a few engines there, as SVG")
    arguments = parser.parse_args()
    known = json.loads(arguments.study.read_text())
    rows = engines()
    arguments.output.write_text(page(known, rows, read_tasks(arguments.tasks) if arguments.tasks else []), encoding="utf-8")
    if arguments.picture:
        from figures import picture
        arguments.picture.write_text(picture(rows, known), encoding="utf-8")


if __name__ == "__main__":
    main()
