# Plots as inline SVG. Colours are CSS variables of the page, or those given.
import math

INK, FAINT, LINE = "var(--ink)", "var(--faint)", "var(--line)"


def number(value):
    return f"{value:.2f}".rstrip("0").rstrip(".")


# Powers of ten from low to high.
def decades(low, high):
    return [10.0**k for k in range(math.ceil(math.log10(low) - 1e-9), math.floor(math.log10(high) + 1e-9) + 1)]


# A frame with axes, in which things are drawn in the units of the data. What lies outside is drawn at its border.
class Plot:
    def __init__(self, width, height, x_range, y_range, log_x=False, log_y=False, margins=(46, 10, 26, 34)):
        self.size = width, height
        left, right, top, bottom = margins
        self.box = left, top, width - right, height - bottom
        self.ranges = x_range, y_range
        self.logs = log_x, log_y
        self.parts = []

    def at(self, x, y):
        placed = []
        for value, (low, high), log, start, end in zip((x, y), self.ranges, self.logs, (self.box[0], self.box[3]),
                                                       (self.box[2], self.box[1])):
            if log:
                value, low, high = math.log10(max(value, low * 1e-9)), math.log10(low), math.log10(high)
            share = min(max((value - low) / (high - low), 0), 1)
            placed.append(start + share * (end - start))
        return placed

    def text(self, x, y, words, anchor="middle", size=11, colour=FAINT, weight=400):
        self.parts.append(f'<text x="{number(x)}" y="{number(y)}" text-anchor="{anchor}" font-size="{size}" '
                          f'font-weight="{weight}" fill="{colour}">{words}</text>')

    def segment(self, a, b, colour=LINE, width=1, dash=""):
        dashes = f' stroke-dasharray="{dash}"' if dash else ""
        self.parts.append(f'<line x1="{number(a[0])}" y1="{number(a[1])}" x2="{number(b[0])}" y2="{number(b[1])}" '
                          f'stroke="{colour}" stroke-width="{width}"{dashes}/>')

    def axes(self, x_ticks, y_ticks, x_label="", y_label="", title=""):
        left, top, right, bottom = self.box
        for value, words in x_ticks:
            x = self.at(value, self.ranges[1][0])[0]
            self.segment((x, top), (x, bottom))
            self.text(x, bottom + 14, words)
        for value, words in y_ticks:
            y = self.at(self.ranges[0][0], value)[1]
            self.segment((left, y), (right, y))
            self.text(left - 5, y + 4, words, "end")
        self.text((left + right) / 2, self.size[1] - 4, x_label)
        if y_label:
            self.parts.append(f'<text transform="translate(12 {number((top + bottom) / 2)}) rotate(-90)" '
                              f'text-anchor="middle" font-size="11" fill="{FAINT}">{y_label}</text>')
        self.text(4, top - 9, title, "start", 12, INK, 600)

    def line(self, points, colour=INK, width=1.5, dash="", title=""):
        placed = " ".join(f"{number(x)},{number(y)}" for x, y in (self.at(*point) for point in points))
        dashes = f' stroke-dasharray="{dash}"' if dash else ""
        self.parts.append(f'<polyline points="{placed}" fill="none" stroke="{colour}" stroke-width="{width}"{dashes} '
                          f'stroke-linejoin="round"><title>{title}</title></polyline>')

    def mark(self, x, y, colour=INK, radius=4, title=""):
        x, y = self.at(x, y)
        self.parts.append(f'<circle cx="{number(x)}" cy="{number(y)}" r="{radius}" fill="{colour}"><title>{title}</title>'
                          '</circle>')

    # `words` for those who do not see it, as HTML.
    def svg(self, words):
        width, height = self.size
        return (f'<svg xmlns="http://www.w3.org/2000/svg" role="img" aria-label="{words}" viewBox="0 0 {width} {height}" '
                f'width="{width}" height="{height}" style="font-family: system-ui, sans-serif">{"".join(self.parts)}</svg>')
