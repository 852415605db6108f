// Figures as SVG: panels with axes, lines, marks and shapes, and one key below them. The fields are those of
// output/figure.h.
const SVG = 'http://www.w3.org/2000/svg';
const PANEL = {width: 480, height: 320, left: 62, right: 12, top: 26, bottom: 42};
const PLOT_DASHES = {solid: '', dashed: '6 5', dotted: '1 4', dashdotted: '9 4 1 4'};
const GRID = '#e6e8eb', AXIS = '#6e7781', SOLID = '#d0d4d9';
const ALL_MARKED = 40, MARKS_ON_A_LINE = 9, KEY_WIDTH = 240, KEY_HEIGHT = 20;

function svg(name, attributes = {}, ...children) {
  const made = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  made.append(...children);
  return made;
}

// Where an axis shows a value, and what it writes beside its ticks.
class Scale {
  constructor({log, min, max}, values, share) {
    this.log = Boolean(log);
    const shown = values.filter((value) => Number.isFinite(value) && !(log && value <= 0)).map((value) => this.map(value));
    let low = Infinity, high = -Infinity;
    for (const value of shown) [low, high] = [Math.min(low, value), Math.max(high, value)];
    if (low > high) [low, high] = [0, 1];
    const least = Math.max(1e-9 * Math.max(Math.abs(low), Math.abs(high)), 1e-290);
    if (high - low < least) [low, high] = [low - (0.1 * Math.abs(low) || 1), high + (0.1 * Math.abs(high) || 1)];
    const margin = share * (high - low);
    this.low = min !== undefined ? this.map(min) : low - margin;
    this.high = max !== undefined ? this.map(max) : high + margin;
    if (!(this.low < this.high)) this.high = this.low + 1;
  }

  map(value) { return this.log ? Math.log10(value) : value; }

  at(value) { return (this.map(value) - this.low) / (this.high - this.low); }

  widen(span) {
    const extra = (span - (this.high - this.low)) / 2;
    this.low -= extra;
    this.high += extra;
  }

  // [value, label], as many as there is room for; minor ticks have no label.
  ticks(most) {
    if (this.log && this.high - this.low >= 1) {
      const ticks = [], step = Math.ceil((this.high - this.low) / most), multiples = step === 1 ? [1, 2, 3, 4, 5, 6, 7, 8, 9] : [1];
      const few = this.high - this.low < 2;
      for (let power = Math.floor(this.low); power <= this.high; ++power) {
        for (const multiple of multiples) {
          const value = multiple * 10 ** power, wanted = few ? [1, 2, 5].includes(multiple) : multiple === 1 && power % step === 0;
          if (this.map(value) >= this.low && this.map(value) <= this.high) ticks.push([value, wanted ? tickLabel(value) : '']);
        }
      }
      return ticks;
    }
    const [from, to] = this.log ? [10 ** this.low, 10 ** this.high] : [this.low, this.high];
    const rough = (to - from) / most, decade = 10 ** Math.floor(Math.log10(rough));
    const step = decade * [1, 2, 5, 10].find((multiple) => multiple * decade >= rough * (1 - 1e-6));
    const ticks = [];
    for (let i = Math.ceil(from / step - 1e-9); i * step <= to + 1e-9 * step; ++i) ticks.push([i * step, tickLabel(i * step, step)]);
    return ticks;
  }
}

const SUPERSCRIPTS = {'-': '⁻', 0: '⁰', 1: '¹', 2: '²', 3: '³', 4: '⁴', 5: '⁵', 6: '⁶', 7: '⁷', 8: '⁸', 9: '⁹'};

// 0.25 or, far from one, 2.5×10⁻⁷; with the decimals of the step between ticks.
function tickLabel(value, step = value) {
  if (value === 0) return '0';
  const power = Math.floor(Math.log10(Math.abs(value)) + 1e-9), last = Math.floor(Math.log10(Math.abs(step)) + 1e-9);
  const far = power >= 5 || power < -3, digits = (value / (far ? 10 ** power : 1)).toFixed(Math.max(0, (far ? power : 0) - last));
  const text = far ? `${digits}×10${[...String(power)].map((digit) => SUPERSCRIPTS[digit]).join('')}` : digits;
  return text.replace(/^1×/, '').replace(/^-/, '−');
}

const MARKS = {
  circle: 'M-3,0a3,3 0 1,0 6,0a3,3 0 1,0 -6,0', square: 'M-3,-3h6v6h-6z', triangle: 'M0,-4L4,3H-4z', triangledown: 'M0,4L4,-3H-4z',
  diamond: 'M0,-4L4,0L0,4L-4,0z', cross: 'M-3,-3L3,3M-3,3L3,-3',
};

function drawMark(marker, colour, x, y) {
  const open = marker.startsWith('open') || marker === 'cross';
  return svg('path', {d: MARKS[marker.replace('open', '')], transform: `translate(${x},${y})`, fill: open ? 'none' : colour,
    stroke: colour, 'stroke-width': 1.3});
}

function extentOf(panel) {
  const xs = [], ys = [];
  const add = (x, y) => { xs.push(x); ys.push(y); };
  for (const {x, y, band} of panel.series) {
    x.forEach((value, i) => add(value, y[i]));
    if (band) y.forEach((value) => ys.push(-value));
  }
  for (const {value, vertical} of panel.reference_lines) (vertical ? xs : ys).push(value);
  for (const {centre: [x, y], radius} of panel.circles) [-radius, radius].forEach((side) => add(x + side, y + side));
  for (const {points} of panel.outlines) points.forEach(([x, y]) => add(x, y));
  return [xs, ys];
}

// The part of a box on the side of a line that its normal points away from (Sutherland and Hodgman 1974).
function clipToSolid(corners, {point, normal}) {
  const height = ([x, y]) => normal[0] * (x - point[0]) + normal[1] * (y - point[1]);
  return corners.flatMap((a, i) => {
    const b = corners[(i + 1) % corners.length], [ha, hb] = [height(a), height(b)], kept = ha <= 0 ? [a] : [];
    if ((ha <= 0) !== (hb <= 0)) kept.push(a.map((value, j) => value + ha / (ha - hb) * (b[j] - value)));
    return kept;
  });
}

class PanelView {
  constructor(panel, wide) {
    this.panel = panel;
    const {width, height} = wide ? {width: 960, height: 440} : PANEL;
    const {left, right, top, bottom} = PANEL;
    this.box = {left, right: width - right, top, bottom: height - bottom};
    const [xs, ys] = extentOf(panel);
    this.x = new Scale(panel.x, xs, 0.02);
    this.y = new Scale(panel.y, ys, 0.05);
    if (panel.equal_aspect) {
      const across = this.box.right - this.box.left, up = this.box.bottom - this.box.top;
      const unit = Math.max((this.x.high - this.x.low) / across, (this.y.high - this.y.low) / up);
      this.x.widen(unit * across);
      this.y.widen(unit * up);
    }
    this.svg = svg('svg', {viewBox: `0 0 ${width} ${height}`, role: 'img', 'aria-label': this.describe()});
    this.drawAxes();
    const clip = `clip${PanelView.count = (PanelView.count ?? 0) + 1}`;
    this.svg.append(svg('clipPath', {id: clip}, svg('rect', {x: left, y: top, width: this.box.right - left, height: this.box.bottom - top})));
    this.inside = svg('g', {'clip-path': `url(#${clip})`});
    this.svg.append(this.inside);
    this.drawShapes();
    for (const line of panel.reference_lines) this.drawLine(line);
    panel.series.forEach((series, i) => this.drawSeries(series, i));
  }

  // In words, for those who do not see it: what the panel shows, and from where to where its lines go.
  describe() {
    const {title, x, y, series, reference_lines: lines} = this.panel, named = new Map();
    const point = ({x: xs, y: ys}, i) => `(${xs[i].toPrecision(3)}, ${ys[i].toPrecision(3)})`;
    for (const one of series) {
      const finite = one.x.map((_, i) => i).filter((i) => Number.isFinite(one.x[i] ?? NaN) && Number.isFinite(one.y[i] ?? NaN));
      if (!one.label || named.has(one.label)) continue;
      named.set(one.label, finite.length > 0 ? `${one.label} from ${point(one, finite[0])} to ${point(one, finite.at(-1))}` : `${one.label} has no points`);
    }
    for (const {label, value} of lines) if (label && !named.has(label)) named.set(label, `${label} at ${value.toPrecision(3)}`);
    const words = [...named.values()], more = words.length > 8 ? [`and ${words.length - 8} more`] : [];
    return `${title ? `${title}: ` : ''}${y.label} against ${x.label}; ${[...words.slice(0, 8), ...more].join(', ')}.`;
  }

  px(x) { return this.box.left + this.x.at(x) * (this.box.right - this.box.left); }

  py(y) { return this.box.bottom - this.y.at(y) * (this.box.bottom - this.box.top); }

  drawAxes() {
    const {left, right, top, bottom} = this.box, {title, x, y} = this.panel;
    const line = (x1, y1, x2, y2, stroke) => svg('line', {x1, y1, x2, y2, stroke});
    const text = (x0, y0, words, anchor, more = {}) => svg('text', {x: x0, y: y0, 'text-anchor': anchor, ...more}, words);
    for (const [value, label] of this.x.ticks((right - left) / 65)) {
      const at = this.px(value);
      if (label) this.svg.append(line(at, top, at, bottom, GRID), text(at, bottom + 17, label, 'middle'));
      this.svg.append(line(at, bottom, at, bottom + (label ? 5 : 3), AXIS));
    }
    for (const [value, label] of this.y.ticks((bottom - top) / 34)) {
      const at = this.py(value);
      if (label) this.svg.append(line(left, at, right, at, GRID), text(left - 8, at + 4, label, 'end'));
      this.svg.append(line(left - (label ? 5 : 3), at, left, at, AXIS));
    }
    this.svg.append(line(left, top, left, bottom, AXIS), line(left, bottom, right, bottom, AXIS),
      text((left + right) / 2, bottom + 36, x.label, 'middle'),
      text(0, 0, y.label, 'middle', {transform: `translate(12,${(top + bottom) / 2}) rotate(-90)`}),
      text(left, 14, title, 'start', {'font-weight': 600}));
  }

  polygon(points, attributes) {
    this.inside.append(svg('polygon', {points: points.map(([x, y]) => `${this.px(x)},${this.py(y)}`).join(' '), ...attributes}));
  }

  drawShapes() {
    const {outlines, half_planes: planes, circles} = this.panel;
    const corners = [[this.x.low, this.y.low], [this.x.high, this.y.low], [this.x.high, this.y.high], [this.x.low, this.y.high]];
    for (const {points, solid} of outlines) {  // what is solid outside of a line would cover all else
      if (solid !== 'outside') continue;
      this.polygon(corners, {fill: SOLID});
      this.polygon(points, {fill: '#ffffff'});
    }
    for (const {points, solid} of outlines) if (solid === 'inside') this.polygon(points, {fill: SOLID});
    for (const plane of planes) this.polygon(clipToSolid(corners, plane), {fill: SOLID, stroke: AXIS});
    for (const {points} of outlines) {
      this.inside.append(svg('polyline', {points: points.map(([x, y]) => `${this.px(x)},${this.py(y)}`).join(' '), fill: 'none', stroke: AXIS, 'stroke-width': 1.5}));
    }
    for (const {centre: [x, y], radius, colour, opacity} of circles) {
      this.inside.append(svg('ellipse', {cx: this.px(x), cy: this.py(y), rx: this.px(x + radius) - this.px(x), ry: this.py(y) - this.py(y + radius),
        fill: colour, 'fill-opacity': opacity, stroke: colour, 'stroke-width': 1.5}));
    }
  }

  drawLine({value, vertical, colour, dash}) {
    const {left, right, top, bottom} = this.box;
    const ends = vertical ? {x1: this.px(value), x2: this.px(value), y1: top, y2: bottom} : {x1: left, x2: right, y1: this.py(value), y2: this.py(value)};
    this.inside.append(svg('line', {...ends, stroke: colour, 'stroke-width': 1.5, 'stroke-dasharray': PLOT_DASHES[dash]}));
  }

  // Points that are not numbers, or not positive on a logarithmic axis, interrupt the line. A band is drawn from -y to y.
  drawSeries({x, y, colour, dash, marker, line, width, band}, index) {
    if (band) {
      const around = [...x.map((value, i) => [value, y[i]]), ...x.map((value, i) => [value, -y[i]]).reverse()];
      if (dash === 'solid') this.polygon(around, {fill: colour, 'fill-opacity': 0.2});
      this.drawSeries({x, y: y.map((value) => -value), colour, dash, marker: 'none', line, width}, index);
    }
    const drawn = (i) => [[this.x, x[i]], [this.y, y[i]]].every(([scale, value]) => Number.isFinite(value ?? NaN) && !(scale.log && value <= 0));
    if (line) {
      let path = '';
      x.forEach((_, i) => { if (drawn(i)) path += `${i > 0 && drawn(i - 1) ? 'L' : 'M'}${this.px(x[i]).toFixed(1)},${this.py(y[i]).toFixed(1)}`; });
      if (path) this.inside.append(svg('path', {d: path, fill: 'none', stroke: colour, 'stroke-width': width, 'stroke-dasharray': PLOT_DASHES[dash], 'stroke-linejoin': 'round'}));
    }
    if (marker === 'none') return;
    const stride = line && x.length > ALL_MARKED ? Math.floor(x.length / MARKS_ON_A_LINE) : 1;
    for (let i = Math.floor(stride * (index % 8) / 8); i < x.length; i += stride) {
      if (drawn(i)) this.inside.append(drawMark(marker, colour, this.px(x[i]), this.py(y[i])));
    }
  }
}

// Every label once, with its style.
function keyOf(panels) {
  const entries = new Map();
  for (const {series, reference_lines: lines} of panels) {
    for (const one of series) if (one.label && !entries.has(one.label)) entries.set(one.label, one);
    for (const one of lines) if (one.label && !entries.has(one.label)) entries.set(one.label, {...one, line: true, marker: 'none', width: 1.5});
  }
  return [...entries];
}

function drawSample({colour, dash, marker, line, width}) {
  const sample = svg('svg', {viewBox: '0 0 30 12', width: 30, height: 12, 'aria-hidden': 'true'});
  if (line) sample.append(svg('line', {x1: 1, x2: 29, y1: 6, y2: 6, stroke: colour, 'stroke-width': Math.min(width, 10), 'stroke-dasharray': PLOT_DASHES[dash]}));
  if (marker !== 'none') sample.append(drawMark(marker, colour, 15, 6));
  return sample;
}

// Returns the whole figure as an SVG file: at most three panels beside each other, and the key below them.
function svgFile(title, views, key) {
  const [, , width, height] = views[0].getAttribute('viewBox').split(' ').map(Number), top = title ? 24 : 0;
  const columns = Math.min(views.length, 3), bottom = top + Math.ceil(views.length / columns) * height;
  const place = (part, size) => {
    const placed = part.cloneNode(true);
    for (const [name, value] of Object.entries(size)) placed.setAttribute(name, value);
    return placed;
  };
  const panels = views.map((view, i) => place(view, {x: i % columns * width, y: top + Math.floor(i / columns) * height, width, height}));
  const across = Math.floor(columns * width / KEY_WIDTH), below = bottom + Math.ceil(key.length / across) * KEY_HEIGHT;
  const entries = key.flatMap(([label, look], i) => {
    const x = 12 + i % across * KEY_WIDTH, y = bottom + Math.floor(i / across) * KEY_HEIGHT;
    return [place(drawSample(look), {x, y}), svg('text', {x: x + 36, y: y + 10}, label)];
  });
  const heading = title ? [svg('text', {x: 12, y: 18, 'font-weight': 600}, title)] : [];
  const file = svg('svg', {viewBox: `0 0 ${columns * width} ${below}`, width: columns * width, height: below, fill: '#24292f',
    'font-family': 'Liberation Sans, Arial, sans-serif', 'font-size': 12},
    svg('rect', {width: '100%', height: '100%', fill: '#ffffff'}), ...heading, ...panels, ...entries);
  return new XMLSerializer().serializeToString(file);
}

function drawFigure({title, panels}) {
  const wide = panels.length === 1 && window.innerWidth >= 700;
  const views = panels.map((panel) => new PanelView(panel, wide).svg);
  const heading = title ? [element('b', {}, title)] : [], key = keyOf(panels);
  const save = element('a', {class: 'save', download: 'figure.svg', href: '#', onclick: () => {
    save.href = URL.createObjectURL(new Blob([svgFile(title, views, key)], {type: 'image/svg+xml'}));
  }}, 'Save as SVG');
  return element('div', {class: 'plot'}, ...heading, element('div', {class: 'panels'}, ...views),
    element('div', {class: 'key'}, ...key.map(([label, look]) => element('span', {}, drawSample(look), label)), save));
}

// ---- Figures that are drawn from the results

const seriesOf = (label, {colour, dash}, x, y) => ({label, x, y, colour, dash, marker: 'none', line: true, width: 2});
const modelSeries = (label, style, x, y) => ({...seriesOf(label, style, x, y), marker: style.marker});
const panelOf = (title, x, y, series, lines = []) => ({title, x, y, series, reference_lines: lines, circles: [], outlines: [], half_planes: []});

const timeLines = (times) => times.map((value) => ({value, vertical: true, label: '', colour: AXIS, dash: 'dotted'}));
const impactLines = ({touches}) => timeLines(touches.slice(0, 8).map(({begin}) => begin));
const boundLines = (bounds) => bounds.map((value) => ({value, vertical: false, label: 'bound', colour: '#cf222e', dash: 'dashed'}));

const levelLine = (value, label) => ({value, vertical: false, label, colour: '#000000', dash: 'dashed'});

const QUANTITIES = ['position', 'velocity', 'control'];
const LOWEST_ERROR = 1e-7;  // errors of right gradients are rounding; below this line they would squeeze all others

const PLOTS = {
  // The loss that each solver has minimized, by iteration. Long lists of numbers are thinned (output/page.h).
  learning_curves({results, styles}) {
    const runs = (results.solve ?? results).runs, curves = [];
    runs.forEach(({losses}, i) => {
      const {every, items: values} = Array.isArray(losses) ? {every: 1, items: losses} : losses ?? {items: []};
      if (values.length > 1) curves.push(seriesOf(styles[i].label, styles[i], values.map((_, k) => every * k), values));
    });
    const log = curves.every(({y}) => y.every((value) => value > 0));
    return curves.length > 0 && {panels: [panelOf('', {label: 'iteration'}, {label: 'loss under the contact model', log}, curves)]};
  },

  // The relative error of each model's gradient by each quantity over the time step. Labels have the order by position.
  refinement({results}, _, {duration, right, styles}) {
    const {scene, audits} = results.audit ?? results;
    const panels = QUANTITIES.flatMap((name) => {
      const curves = audits.flatMap(({contact, refinement}) => {
        const [study, first] = [name, 'position'].map((one) => refinement?.quantities.find(({quantity}) => quantity === one));
        if (!study) return [];
        const order = first.verdict === 'right' ? 'right' : (Math.abs(first.order) < 0.05 ? 0 : first.order).toFixed(1);
        return [modelSeries(`${contact} (${order})`, styles[contact], study.steps.map((steps) => duration / steps), study.error)];
      });
      if (curves.length === 0) return [];
      const max = 2 * Math.max(1, ...curves.flatMap(({y}) => y));
      return [panelOf(`by ${name}`, {label: 'time step (s)', log: true},
        {label: 'relative error of the gradient', log: true, min: LOWEST_ERROR, max}, curves, [levelLine(right, 'right')])];
    });
    return panels.length > 0 && {title: `${scene}: error against the exact gradient (order by position)`, panels};
  },

  // Slope of the loss over the width of differences, for the entry of each quantity on which they contradict a model most.
  widths({results}, _, {untelling, styles}) {
    const {scene, audits} = results.audit ?? results, swept = audits.filter(({width_sweep: sweep}) => sweep);
    const panels = QUANTITIES.flatMap((name) => {
      const tells = ({quantity, finding}) => quantity === name && !untelling.includes(finding);
      const telling = swept.flatMap(({width_sweep: {sweeps}}) => sweeps.filter(tells)), miss = ({gradient, wide}) => Math.abs(gradient - wide);
      if (telling.length === 0) return [];
      const {entry} = telling.reduce((most, one) => (miss(one) > miss(most) ? one : most));
      const shown = swept.map(({contact, width_sweep: {sweeps}}) => ({contact, ...sweeps.find((one) => one.quantity === name && one.entry === entry)}));
      // Single differences across an impact that changes step would hide the levels.
      const levels = shown.flatMap(({narrow, wide}) => [narrow, wide]), low = Math.min(...levels), high = Math.max(...levels);
      const size = Math.max(Math.abs(low), Math.abs(high)), margin = size > 0 ? Math.max(0.25 * (high - low), 1e-6 * size) : 1;
      const exact = shown.map((one) => one.exact).filter((value) => typeof value === 'number').slice(0, 1);
      return [panelOf(`d loss / d ${entry}`, {label: 'width / grid width', log: true}, {label: 'slope', min: low - margin, max: high + margin},
        shown.map(({contact, widths, slopes, grid_width: grid}) => modelSeries(contact, styles[contact], widths.map((width) => width / grid), slopes)),
        exact.map((value) => levelLine(value, 'exact')))];
    });
    return panels.length > 0 && {title: `${scene}: differences of the loss, from narrower to wider than a step`, panels};
  },

  // Positions and speeds of up to six discs over time, of the first motion that is shown, and its impacts.
  motion(_, replay) {
    const motion = replay?.motions.find(({visible}) => visible) ?? replay?.motions[0];
    const moving = (replay?.discs ?? []).map((_, i) => i).filter((i) => !replay.discs[i].fixed).slice(0, DISC_COLOURS.length);
    if (!motion || moving.length === 0) return null;
    const impacts = impactLines(motion);
    const width = 4 * replay.discs.length, {states} = motion.path, times = [...motion.path.times];
    const panel = (label, valueOf) => panelOf('', {label: 'time (s)'}, {label}, moving.map((disc) => (
      seriesOf(replay.discs[disc].name, {colour: DISC_COLOURS[disc % DISC_COLOURS.length], dash: 'solid'}, times,
        times.map((_, row) => valueOf(row * width + 4 * disc))))), impacts);
    return {panels: [panel('x (m)', (at) => states[at]), panel('y (m)', (at) => states[at + 1]),
      panel('speed (m/s)', (at) => Math.hypot(states[at + 2], states[at + 3]))]};
  },

  // Forces and torques over time, of the motions that the replay shows, and the impacts of the first one.
  controls(_, replay) {
    const same = ({control: l}, {control: r}) => l.length === r.length && l.every((value, i) => value === r[i]);
    const all = replay?.motions ?? [], motions = all.filter((motion, i) => motion.ends.length > 0 && !(i > 0 && same(motion, all[i - 1])));
    if (motions.length === 0) return null;
    const panels = [], [{pushed, torques}] = motions, {discs, walls} = replay;
    const timed = all.map(({touches}) => touches.filter(({begin, end}) => begin === end)).find((touches) => touches.length > 0) ?? [];
    const impacts = timed.slice(0, 8).map(({a, b, wall, begin}) => (
      {value: begin, vertical: true, label: `impact of ${discs[a].name} and ${(wall ? walls : discs)[b].name}`, colour: AXIS, dash: 'dotted'}));
    const add = (title, label, value, bounds) => panels.push(panelOf(title, {label: 'time (s)'}, {label}, motions.map((motion) => {
      const x = [], y = [];
      motion.ends.forEach((end, k) => { x.push(k > 0 ? motion.ends[k - 1] : 0, end); y.push(value(motion, k), value(motion, k)); });
      return seriesOf(motion.label, motion, x, y);
    }), [...impacts, ...boundLines(bounds)]));
    const bothSigns = (bound) => (bound > 0 ? [-bound, bound] : []);
    pushed.slice(0, 4).forEach((disc, c) => {
      const {name, bounds: [component, norm, torque]} = discs[disc], force = ({control}, k, j) => control[2 * (pushed.length * k + c) + j];
      ['x', 'y'].forEach((axis, j) => add(name, `force ${axis} (N)`, (motion, k) => force(motion, k, j), bothSigns(component)));
      add(name, 'size of the force (N)', (motion, k) => Math.hypot(force(motion, k, 0), force(motion, k, 1)), norm > 0 ? [norm] : []);
      const turned = torques?.some((value, i) => i % pushed.length === c && value !== 0);
      if (turned) add(name, 'torque (N m)', (motion, k) => motion.torques?.[pushed.length * k + c] ?? NaN, bothSigns(torque));
    });
    return {panels};
  },

  // Where the positions of discs are about the plan with a probability of 0.95, in each direction, over time.
  spreads(_, replay) {
    const motion = replay?.motions.find(({spreads}) => spreads.length > 0);
    if (!motion) return null;
    const impacts = impactLines(motion);
    const moving = replay.discs.map((_, i) => i).filter((i) => !replay.discs[i].fixed).slice(0, 4);
    return {panels: moving.flatMap((disc) => ['x', 'y'].map((axis, j) => (
      panelOf(replay.discs[disc].name, {label: 'time (s)'}, {label: `deviation in ${axis} (mm)`}, motion.spreads.map(({label, times, covariances}, i) => {
        const y = [...times].map((_, k) => 1960 * Math.sqrt(Math.max(covariances[3 * (k * replay.discs.length + disc) + 2 * j], 0)));
        return {...seriesOf(label, {colour: ['#7c3aed', '#57606a'][i % 2], dash: i === 0 ? 'solid' : 'dashed'}, [...times], y), band: true};
      }), impacts))))};
  },
};
