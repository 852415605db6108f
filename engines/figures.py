# The figures of the page of engines.
import html

from svg import FAINT, INK, Plot, decades
from verdict import gradient_errors, of_contact, relative_error

# A colour of the page for each class of contact.
COLOURS = [("impact time", "var(--impact-time)"), ("force", "var(--force)"), ("projection", "var(--projection)"),
           ("impulse", "var(--impulse)"), ("depth", "var(--depth)"), ("", "var(--unclear)")]


def colour_of(study):
    contact = of_contact(study)
    return next(colour for start, colour in COLOURS if contact.startswith(start))


def exponent(value):
    power = f"{value:.0e}".split("e")
    return f"{power[0]}e{int(power[1])}"


def scan_panel(title, losses, known, curve, size=(240, 170)):
    exact = known["exact"]["scan"]
    plot = Plot(*size, (-20, 20), (1.965, 2.125), margins=(36, 16, 24, 22))
    plot.axes([(x, f"{x:+d}" if x else "-2 m") for x in (-20, 0, 20)],
              [(y, f"{y:.2f}") for y in (2.0, 2.05, 2.1)], title=html.escape(title))
    at = [1000 * x for x in known["scan"]]  # mm
    plot.line(list(zip(at, exact)), "#9aa4af", 3.5)
    plot.line(list(zip(at, losses)), curve, 1.3)
    return plot.svg(f"loss of {html.escape(title)} against the start of the striker, and the exact loss")


def scans(rows, known):
    return [scan_panel(row["engine"], known["engines"][row["id"]]["scan"], known, "var(--curve)") for row in rows]


# Curves of errors that names at their right ends tell apart, pushed apart where they would overlap.
def labelled_curves(plot, curves):
    right = plot.box[2]
    ends = sorted((plot.at(*points[-1])[1], title, colour) for title, colour, points in curves)
    for title, colour, points in curves:
        plot.line(points, colour, title=html.escape(title))
    below = plot.box[1] - 11
    placed = []
    for y, title, colour in ends:
        below = max(y, below + 11)
        placed.append([below, y, title, colour])
    over = max(0, below - plot.box[3])
    for label in placed:
        label[0] -= over * (label[0] - plot.box[1]) / max(below - plot.box[1], 1)
    for label_y, y, title, colour in placed:
        plot.segment((right, y), (right + 12, label_y), colour, 0.6)
        plot.text(right + 15, label_y + 4, html.escape(title), "start", 9.5, colour)


def error_plot(curves, x_range, x_ticks, x_label, narrow):
    low, high = 1e-10, 1e3
    size, margins = ((380, 500), (52, 172, 14, 40)) if narrow else ((900, 470), (60, 200, 14, 40))
    plot = Plot(*size, x_range, (low, high), True, True, margins)
    what = "relative error of the gradient"
    plot.axes(x_ticks[::2] if narrow else x_ticks, [(y, exponent(y)) for y in decades(low, high)], x_label, what)
    labelled_curves(plot, curves)
    return plot.svg(f"{what} by {x_label}, of {len(curves)} engines")


def error_by_step(rows, known, narrow=False):
    curves = [(row["engine"], colour_of(known["engines"][row["id"]]),
               list(zip(known["steps"], gradient_errors(known["engines"][row["id"]], known["exact"])))) for row in rows]
    return error_plot(curves, (110, known["steps"][-1]), [(steps, str(steps)) for steps in known["steps"]], "steps",
                      narrow)


def error_by_width(rows, known, narrow=False):
    curves = []
    for row in rows:
        by_width = known["engines"][row["id"]]["by_width"]
        points = [(float(width), relative_error(gradient, known["exact"]["gradient"]))
                  for width, gradient in by_width.items()]
        curves.append((row["engine"], colour_of(known["engines"][row["id"]]), sorted(points)))
    return error_plot(curves, (1e-7, 0.03), [(w, exponent(w)) for w in decades(1e-7, 1e-2)],
                      "width of the differences, m or m/s", narrow)


def class_diagram(rows, known, narrow=False):
    size, margins = ((380, 430), (52, 14, 16, 40)) if narrow else ((900, 430), (60, 20, 16, 40))
    plot = Plot(*size, (-0.35, 0.08), (-2.2, 1.4), margins=margins)
    plot.axes([(x / 100, f"{x / 100:.2f}") for x in range(-30 if narrow else -35, 6, 10 if narrow else 5)],
              [(y, str(y)) for y in (-2, -1, 0, 1)], "feed", "keep")
    for value, words in ((1, "impulse at a step boundary"), (0, "projection"),
                         (-1, "impact time resolved, or a resolved force")):
        y = plot.at(0, value)[1]
        if narrow:
            plot.text(plot.box[0] + 4, y + 14, words, "start", 11, INK)
        else:
            plot.text(plot.at(-0.006, 0)[0], y - 6, words, "end", 11, INK)
    plot.text(plot.at(-0.2, 0)[0], plot.at(0, 1.28)[1], "depth feedback", "middle", 11, INK)
    for row in rows:
        study = known["engines"][row["id"]]
        for steps, radius in (("240", 3), ("2400", 5.5)):
            impact = study["impact"][steps]
            if isinstance(impact, dict):
                title = f'{row["engine"]}, {steps} steps: keep {impact["keep"]:.3f}, feed {impact["feed"]:.3f}'
                plot.mark(impact["feed"], impact["keep"], colour_of(study), radius, html.escape(title))
        fine = study["impact"]["2400"]
        # Where there is no room, names are in the table only.
        if not narrow and isinstance(fine, dict) and min(abs(fine["keep"] - named) for named in (1, 0, -1)) > 0.08:
            x, y = plot.at(fine["feed"], fine["keep"])
            side = -1 if fine["feed"] < -0.21 else 1
            plot.text(x + 8 * side, y + 4, html.escape(row["engine"]), "end" if side < 0 else "start", 9.5,
                      colour_of(study))
    return plot.svg("what is left of a displacement (keep) and what is fed back to the velocity (feed), by engine")


# A few engines, in fixed colours and on white, for pages that cannot say what colours are.
PICTURED = ["box2d", "jolt", "physx_tgs", "rapier", "bullet64", "mujoco2", "havok", "siconos_event"]


def picture(rows, known, columns=4):
    width, height, head = 240, 170, 26
    chosen = [row for row in rows if row["id"] in PICTURED and "scan" in known["engines"].get(row["id"], {})]
    chosen.sort(key=lambda row: PICTURED.index(row["id"]))
    panels = []
    for i, row in enumerate(chosen):
        panel = scan_panel(row["engine"], known["engines"][row["id"]]["scan"], known, "#0550ae")
        x, y = i % columns * width, head + i // columns * height
        panels.append(panel.replace("<svg ", f'<svg x="{x}" y="{y}" ', 1))
    total = columns * width, head + -(-len(chosen) // columns) * height
    body = "".join(panels).replace("var(--ink)", "#24292f").replace("var(--faint)", "#59636e").replace(
        "var(--line)", "#d8dee4")
    return (f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {total[0]} {total[1]}" width="{total[0]}" '
            f'height="{total[1]}" font-family="sans-serif"><rect width="100%" height="100%" fill="#ffffff"/>'
            f'<text x="8" y="18" font-size="12" fill="#24292f">Loss of task 3 against the start of the striker in mm '
            f'(blue), and the exact one (grey)</text>{body}</svg>\n')
