// Motions of hybrid systems, in the documents of their programs (programs/hybrid_program.h).
// One number of the samples in a motion over time, by its name; interrupted at events and where its mode has no such number.
function hybridCurves(motion, key, namesOf) {
  const curves = new Map();
  motion.times.forEach((time, k) => {
    const jumps = k > 0 && motion.times[k - 1] === time;
    namesOf(motion.modes[k]).forEach((name, i) => {
      if (!curves.has(name)) curves.set(name, {...seriesOf(name, {colour: DISC_COLOURS[curves.size % DISC_COLOURS.length], dash: 'solid'}, [], []), last: k});
      const curve = curves.get(name);
      if (jumps || curve.last < k - 1) { curve.x.push(time); curve.y.push(null); }
      curve.x.push(time);
      curve.y.push(motion[key][k][i]);
      curve.last = k;
    });
  });
  return [...curves.values()];
}

// Each control that is not zero throughout over time, on intervals of these lengths, or on equal ones.
function hybridControls({system, control_bounds: bounds}, input, durations, events) {
  const rows = input.control, lengths = durations ?? rows.map(() => input.duration / rows.length);
  let end = 0;
  const ends = lengths.map((length) => (end += length));
  return system.controls.flatMap((name, i) => {
    if (rows.every((row) => row[i] === 0)) return [];
    const x = ends.flatMap((time, k) => [k > 0 ? ends[k - 1] : 0, time]);
    return [panelOf(name, {label: 'time'}, {label: name},
      [seriesOf('', {colour: DISC_COLOURS[i % DISC_COLOURS.length], dash: 'solid'}, x, rows.flatMap((row) => [row[i], row[i]]))],
      [...events, ...boundLines([bounds?.min[i], bounds?.max[i]].filter((bound) => typeof bound === 'number'))])];
  });
}

function hybridFigure(data, motion, input, durations) {
  const {system} = data;
  const modeOf = (name) => system.modes.find((mode) => mode.name === name);
  const events = timeLines(motion.events.map(({time}) => time));
  const states = hybridCurves(motion, 'states', (mode) => modeOf(mode).states).map((curve) => (
    panelOf(curve.label, {label: 'time'}, {label: curve.label}, [{...curve, label: ''}], events)));
  const guards = hybridCurves(motion, 'guards', (mode) => modeOf(mode).guards);
  const controls = hybridControls(data, input, durations, events);
  return {panels: [...states, ...controls, ...(guards.length === 0 ? [] : [panelOf('guards', {label: 'time'}, {label: 'guard'}, guards, events)])]};
}

// Lines and circles of each sample, played over time.
class HybridReplay extends Player {
  constructor(motion) {
    super();
    this.motion = motion;
    this.duration = motion.times.at(-1) || 1;
    const xs = [], ys = [];
    for (const {lines, circles} of motion.frames) {
      for (const [a, b, c, d] of lines) { xs.push(a, c); ys.push(b, d); }
      for (const [x, y, r] of circles) { xs.push(x - r, x + r); ys.push(y - r, y + r); }
    }
    const least = (list) => list.reduce((l, r) => Math.min(l, r), Infinity), most = (list) => list.reduce((l, r) => Math.max(l, r), -Infinity);
    const [x0, y0, width, height] = [least(xs), least(ys), most(xs) - least(xs), most(ys) - least(ys)];
    const size = Math.max(width, height) || 1, margin = 0.05 * size;
    this.drawing = svg('g', {transform: 'scale(1 -1)', stroke: '#24292f', fill: 'none', 'stroke-width': 0.006 * size});
    const picture = svg('svg', {viewBox: `${x0 - margin} ${-y0 - height - margin} ${width + 2 * margin} ${height + 2 * margin}`, role: 'img',
      'aria-label': 'replay of the motion', style: 'max-height: 60vh'}, this.drawing);
    this.slider.max = this.duration;
    this.seek(0);
    this.element = element('div', {class: 'replay plot'}, picture, element('div', {class: 'buttons'}, this.playButton, this.clock),
      element('div', {class: 'line'}, this.slider));
  }

  seek(time) {
    this.time = Math.min(time, this.duration);
    const {times, frames, modes} = this.motion;
    const next = times.findIndex((at) => at > this.time), k = next < 0 ? times.length - 1 : Math.max(next - 1, 0);
    this.drawing.replaceChildren(...frames[k].lines.map(([x1, y1, x2, y2]) => svg('line', {x1, y1, x2, y2})),
      ...frames[k].circles.map(([cx, cy, r]) => svg('circle', {cx, cy, r})));
    this.slider.value = this.time;
    this.clock.value = `${this.time.toFixed(3)}, mode ${modes[k]}`;
  }
}
