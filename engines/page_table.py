# Tables of the page. On a screen that they do not fit, rows become cards, with the head of its column above each cell.
import html


# A cell of HTML, with the classes of the style sheet below.
def cell(content, classes=""):
    return content, classes


# A row that has fewer cells than there are heads ends in one that goes on to the last column.
def table(heads, rows, name):
    body = "".join(f"<tr>{''.join(cells_of(heads, row))}</tr>" for row in rows)
    columns = "".join(f'<th scope="col">{html.escape(head)}</th>' for head in heads)
    return (f'<div class="scroll" tabindex="0"><table class="{name}"><thead><tr>{columns}</tr></thead>'
            f"<tbody>{body}</tbody></table></div>")


def cells_of(heads, row):
    for i, (head, (content, classes)) in enumerate(zip(heads, row)):
        span = len(heads) - i if i + 1 == len(row) else 1
        spans = f' colspan="{span}"' if span > 1 else ""
        shade = f' class="{classes}"' if classes else ""
        yield f'<td data-label="{html.escape(head)}"{shade}{spans}>{content}</td>'


# `widths`: below how many rem the tables of a name are cards.
def style(widths):
    cards = "".join(f"@container (max-width: {width}rem) {{ {as_cards('.' + name)} }}\n"
                    for name, width in widths.items())
    return (".scroll { container-type: inline-size; }\n"
            "@media screen and (max-width: 48rem) { .scroll { max-height: 80vh; overflow-y: auto; } }\n" + cards)


def as_cards(table):
    return f"""
{table} thead {{ display: none; }}
{table}, {table} tbody {{ display: block; }}
{table} tr {{ display: grid; grid-template-columns: repeat(auto-fill, minmax(8.5rem, 1fr)); gap: .3rem .75rem;
  padding: .6rem .75rem; border-bottom: 1px solid var(--line); }}
{table} td {{ border: 0; padding: 0 .3rem; text-align: left; min-width: 0; overflow-wrap: anywhere; white-space: normal;
  border-radius: 4px; }}
{table} td::before {{ content: attr(data-label); display: block; color: var(--faint); font-weight: 400; font-size: .85em; }}
{table} td:empty {{ display: none; }}
{table} td:first-child, {table} td[colspan] {{ grid-column: 1 / -1; }}
{table} td:first-child {{ font-weight: 600; }}
{table} td:first-child::before, {table} td[colspan]::before {{ content: none; }}
"""
