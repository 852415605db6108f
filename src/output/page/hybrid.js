// The document of a hybrid system's program (programs/hybrid_program.h) as parts of a page.
const shown = (value, digits = 10) => (
  typeof value === 'number' ? String(Number(value.toPrecision(digits))) : value === null || value === undefined ? '' : String(value));

// A number of noisy runs or to first order, with the digits of the programs' tables.
const statistic = (value) => (typeof value === 'number' ? Number(value.toPrecision(4)) : value);

// Without columns that are empty.
function hybridTable(heads, rows) {
  const kept = heads.map((_, j) => j).filter((j) => j === 0 || rows.some((row) => shown(row[j]) !== ''));
  const columns = kept.map((j) => ({header: heads[j], number: rows.every((row) => typeof row[j] === 'number')}));
  return {keys: 1, columns, rows: rows.map((row) => kept.map((j) => shown(row[j])))};
}

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
    this.clock = element('output', {class: 'clock'});
    this.slider = element('input', {type: 'range', min: 0, max: this.duration, step: this.duration / 1000, value: 0, 'aria-label': 'time',
      oninput: () => this.seek(Number(this.slider.value))});
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

function hybridParts(data) {
  const {system, runs, motion, guess, gradient, audits} = data, parts = [];
  const heading = (text) => parts.push({kind: 'heading', text});
  const table = (caption, heads, rows) => parts.push({kind: 'table', caption, table: hybridTable(heads, rows)});
  parts.push({kind: 'text', text: `${system.modes.length} mode${system.modes.length === 1 ? "" : "s"}; loss of the initial guess: ${shown(data.loss) || data.failed}`});
  if (runs.length > 0) {
    heading('Solvers');
    table('The runs of the solvers.', ['solver', 'initial loss', 'final loss', 'duration', 'iterations', 'termination', 'certificate', 'remark'],
      runs.map((run) => [run.solver, run.initial_loss, run.final_loss, run.solution?.duration, run.iterations, run.termination,
        run.certificate?.verdict, run.reason]));
  }
  const studies = [...runs.map((run) => [run.solver, run.feedback]), ['initial guess', data.feedback]].filter(([, study]) => study);
  if (studies.length > 0) {
    heading('Feedback');
    table('Root mean square of the final error, and runs with other events than planned: of noisy runs, and to first order.',
      ['run', 'loop', 'final error', 'first order', 'noisy runs', 'other events', 'probability to first order', 'failed', 'remark'],
      studies.flatMap(([name, study]) => (study.failed ? [[name, '', null, null, null, null, null, null, study.failed]]
        : ['open', 'closed'].filter((loop) => study[loop]).map((loop) => {
          const {final_error, change_probability, warning, runs: noisy = {}} = study[loop];
          return [name, loop, statistic(noisy.final_error), statistic(final_error), noisy.samples, noisy.otherwise,
            statistic(change_probability), noisy.failed, warning];
        }))));
  }
  const motions = runs.filter((run) => run.motion).map((run) => [run.solver, run.motion, run.solution, run.durations]);
  for (const [name, one, input, durations] of [...motions, ['initial guess', motion, guess]]) {
    heading(`Motion: ${name}`);
    if (one.failed) parts.push({kind: 'text', text: `The motion ends early: ${one.failed}`});
    if (one.remark) parts.push({kind: 'text', text: one.remark});
    if (one.frames) parts.push({kind: 'element', element: new HybridReplay(one).element, caption: 'The motion over time.'});
    if (one.times.length > 0) parts.push({kind: 'figure', figure: hybridFigure(data, one, input, durations), caption: 'States, controls and guards over time. Dotted: events; dashed: bounds.'});
    table('Events.', ['event', 'time', 'mode', 'guard', 'next mode'], one.events.map((event, i) => [i + 1, event.time, event.mode, event.guard, event.next_mode]));
  }
  if (gradient) {
    heading('Gradient of the loss at the initial guess');
    const states = system.modes.find((mode) => mode.name === guess.mode).states;
    table('Derivatives of the loss.', ['variable', 'value', 'derivative'], [
      ...states.map((name, i) => [`${name} at the start`, guess.initial[i], gradient.initial[i]]),
      ...system.parameters.map((name, i) => [name, guess.parameters[i], gradient.parameters[i]]),
      ['duration', guess.duration, gradient.duration]]);
  }
  if (audits?.length) {
    heading('Audit of time-stepping schemes');
    table('Verdicts on the gradients of the schemes.', ['scheme', 'verdict', 'steps', 'loss', 'exact loss', 'order', 'reason'],
      audits.map((audit) => [audit.scheme, audit.verdict, audit.steps, audit.loss, audit.exact_loss, audit.order, audit.reason]));
  }
  return parts;
}
