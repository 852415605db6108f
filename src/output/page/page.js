// Draws the document of a page (output/page.h): its parts in their order, and the contents.
const TALL_TABLE = 40, LONG_TEXT = 40, SHORT_NAME = 16;

// Text in which `words between backquotes` are code; a backquote without a partner stays one.
function inline(text) {
  const pieces = text.split('`');
  if (pieces.length % 2 === 0) pieces.push([pieces.pop(), pieces.pop()].reverse().join('`'));
  return pieces.map((piece, i) => (i % 2 === 1 ? element('code', {}, piece) : piece));
}

// Long names break behind an underscore, not anywhere.
function breakable(name) {
  if (name.length <= SHORT_NAME) return [name];
  return name.split(/(?<=_)/).flatMap((piece, i) => (i > 0 ? [element('wbr'), piece] : [piece]));
}

function drawTable({keys, columns, rows}) {
  const classes = (column, more) => [columns[column].number && 'number', column < keys && 'key', ...more].filter(Boolean).join(' ');
  const head = columns.map(({header}, j) => element('th', {scope: 'col', class: classes(j, [])}, header));
  const body = rows.map((row) => element('tr', {}, ...row.map((cell, j) => {
    const [text, tone] = Array.isArray(cell) ? cell : [cell];
    const long = text.split('\n').some((line) => line.length > LONG_TEXT);
    return element('td', {'data-label': columns[j].header, class: classes(j, [tone, long && 'long'])},
      ...(j < keys ? breakable(text) : [text]));
  })));
  const table = element('table', {}, element('thead', {}, element('tr', {}, ...head)), element('tbody', {}, ...body));
  return element('div', {class: rows.length > TALL_TABLE ? 'scroll tall' : 'scroll', tabindex: 0}, table);
}

// Long remarks, in the last column, become notes below the table, whose numbers stand in the column before.
function withRemarksAsNotes({columns, rows, ...table}) {
  const remarks = columns[columns.length - 1].header === 'remark' ? rows.map((row) => row[row.length - 1]) : [];
  if (!remarks.some((text) => text.length > LONG_TEXT)) return {table: {columns, rows, ...table}};
  const notes = [...new Set(remarks.filter((text) => text !== ''))];
  const numbered = rows.map((row, i) => {
    const [text, ...tone] = [row[row.length - 2]].flat();
    const number = remarks[i] && ` [${notes.indexOf(remarks[i]) + 1}]`;
    return [...row.slice(0, -2), [text + number, ...tone]];
  });
  return {table: {columns: columns.slice(0, -1), rows: numbered, ...table}, notes};
}

class Page {
  constructor(data) {
    this.data = data;
    this.main = document.querySelector('main');
    this.numbers = {Table: 0, Figure: 0};
    this.sections = [];
    this.replays = [];
    document.title = data.title;
    const subtitle = data.subtitle ? [element('p', {class: 'subtitle'}, ...inline(data.subtitle))] : [];
    this.main.replaceChildren(element('header', {}, element('h1', {}, data.title), ...subtitle));
    for (const part of data.parts) {
      try {
        this[part.kind](part);
      } catch (error) {
        this.main.append(element('p', {role: 'alert'}, `A part of this page cannot be shown: ${error.message}`));
        console.error(error);
      }
    }
    if (this.sections.length === 0) return;
    const contents = this.sections.map(({id, text}) => element('li', {}, element('a', {href: `#${id}`}, text)));
    this.main.before(element('nav', {'aria-label': 'Contents'},
      element('details', {open: ''}, element('summary', {}, 'Contents'), element('ol', {}, ...contents))));
  }

  // The number makes equal headings distinct.
  heading({text}) {
    const id = `s${this.sections.length + 1}-${text.toLowerCase().replace(/[^a-z0-9]+/g, '-')}`;
    this.sections.push({id, text});
    this.main.append(element('h2', {id}, element('a', {href: `#${id}`}, ...inline(text))));
  }

  text({text}) { this.main.append(element('p', {}, ...inline(text))); }

  code({text}) { this.main.append(element('pre', {}, text)); }

  // Items are texts; those with a time show it in the replay.
  list({items}) {
    this.main.append(element('ul', {}, ...items.map(({text, motion, time}) => {
      const show = () => this.replays[0].show(motion, time);
      const button = time === undefined ? [] : [element('button', {type: 'button', class: 'moment', onclick: show}, 'show')];
      return element('li', {}, ...inline(text), ...button);
    })));
  }

  tiles({tiles}) {
    this.main.append(element('dl', {class: 'tiles'}, ...tiles.map(({value, label, tone}) => (
      element('div', {class: `tile ${tone}`}, element('dt', {}, ...inline(label)), element('dd', {}, value))))));
  }

  links({files}) {
    this.main.append(element('p', {class: 'links'}, ...files.flatMap((file) => [element('a', {href: `./${encodeURI(file)}`}, file), ' '])));
  }

  table({caption, folded, ...part}) {
    const {table, notes} = part.notes ? part : withRemarksAsNotes(part.table);
    const after = notes ? [element('ol', {class: 'notes'}, ...notes.map((note) => element('li', {}, ...inline(note))))] : [];
    this.numbered('Table', caption, folded, drawTable(table), ...after);
  }

  figure({figure, caption}) { this.numbered('Figure', caption, false, drawFigure(figure)); }

  // The motion of a run of a hybrid system or, without a run, of its initial guess.
  motion({run}) {
    const {results} = this.data, {motion, solution, durations} = run === null ? {motion: results.motion, solution: results.guess} : results.runs[run];
    if (motion.frames) this.numbered('Figure', 'The motion over time.', false, new HybridReplay(motion).element);
    if (motion.times.length === 0) return;
    this.figure({figure: hybridFigure(results, motion, solution, durations), caption: 'States, controls and guards over time. Dotted: events; dashed: bounds.'});
  }

  // A figure of the results, if there is anything to draw.
  plot({plot, caption, more}) {
    const figure = PLOTS[plot](this.data, this.replays[0], more);
    if (figure) this.figure({figure, caption});
  }

  replay({replay, caption}) {
    const place = element('div'), figure = this.numbered('Figure', caption, false, place);
    figure.classList.add('replay');
    this.replays.push(new Replay(place, replay));
    if (this.replays.length > 1) return;
    this.plot({plot: 'motion', caption: 'Positions and speeds over time, of the first motion that is shown. Dotted: impacts.'});
  }

  // Captions stand where they are read first: above a table, which may be long, and below a figure.
  numbered(kind, caption, folded, ...content) {
    const label = `${kind} ${++this.numbers[kind]}`, text = [element('b', {}, `${label}.`), ' ', ...inline(caption)];
    const figure = element('figure', {id: label.toLowerCase().replace(' ', '-')});
    if (folded) figure.append(element('details', {}, element('summary', {}, ...text), ...content));
    else if (kind === 'Table') figure.append(element('figcaption', {}, ...text), ...content);
    else figure.append(...content, element('figcaption', {}, ...text));
    this.main.append(figure);
    return figure;
  }
}

window.saltusReplays = new Page(JSON.parse(document.getElementById('document').textContent)).replays;
