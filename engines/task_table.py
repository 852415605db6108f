# The table of what engines/tasks.py found, for the page: a row for each engine, a cell for each task.
import html

from page_table import cell, table
from tasks import TASKS

SHADES = {"right": "good", "consistent": "good", "ambiguous": "warning", "failed": "warning", "not applicable": "faint"}


def percent(error):
    value = 100 * float(error)
    if value < 1e-3:
        return f"{value:.1g} %" if value > 1e-8 else "0 %"
    return f"{value:.2g} %" if value < 100 else f"{value:.0f} %" if value < 1e4 else f"{value / 100:.0f} times"


def cell_of(found):
    if found is None:
        return cell("not measured", "faint")
    shade, verdict = SHADES.get(found["verdict"], "bad"), html.escape(found["verdict"])
    if not found["loss"]:
        return cell(f'{verdict}<br><span class="faint">{html.escape(found["reason"])}</span>', shade)
    motion = " (does not converge)" if found["motion"] == "does not converge" else ""
    wide = f', {percent(found["wide_error"])}' if found["wide_error"] else ""
    return cell(f'{verdict}<br><span class="faint">loss {percent(found["loss_error"])}{motion}<br>'
                f'gradient {percent(found["narrow_error"])}{wide}</span>', shade)


# `found`: rows of the table of tasks; rows of engines that none of them names are left out.
def task_table(rows, found):
    cells = {(row["id"], row["task"]): row for row in found}
    heads = ["engine"] + [title for _, title, _ in TASKS.values()]
    return table(heads, [[cell(html.escape(row["engine"]))] + [cell_of(cells.get((row["id"], task))) for task in TASKS]
                         for row in rows if any(key[0] == row["id"] for key in cells)], "tasks")


# How many engines each verdict is of, by task, in a sentence.
def task_summary(found):
    sentences = []
    for task, (_, title, _) in TASKS.items():
        rows = [row for row in found if row["task"] == task and row["loss"]]
        right = sum(row["verdict"] in ("right", "consistent") for row in rows)
        astray = sum(row["motion"] == "does not converge" for row in rows)
        if rows:
            sentences.append(f"{title}: of {len(rows)} gradients {right or 'none'} right or consistent, of {astray or 'none'} "
                             "the motion does not converge")
    return "; ".join(sentences).capitalize() + "."
