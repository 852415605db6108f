const SMOOTH = 300;  // points of a path that is curved

// `columns` columns of `rows` numbers each, as one array row by row. A number is a multiple of its column's quantum; a
// column is written as its second differences.
function unpack({data, quanta}, rows, columns) {
  const numbers = new Float64Array(rows * columns);
  let at = 0;
  for (let column = 0; column < columns; ++column) {
    let value = 0, slope = 0;
    for (let row = 0; row < rows; ++row) {
      slope += data[at++];
      value += slope;
      numbers[row * columns + column] = value * quanta[column % quanta.length];
    }
  }
  return numbers;
}

// One motion of a replay: positions of its discs at any time, contacts and forces. It shares the objects of the replay for all discs
// and walls that do not differ from them.
class Motion {
  constructor(data, {discs, walls, outlines}) {
    const place = {discs, walls, outlines}, same = (l, r) => JSON.stringify(l) === JSON.stringify(r);
    for (const [list, shared] of Object.entries(place)) {
      this[list] = data[list]?.map((item, i) => (same(item, shared[i]) ? shared[i] : item)) ?? shared;
    }
    this.label = data.label;
    this.remark = data.remark;
    this.colour = data.colour;
    this.dash = data.dash;
    this.arcs = data.arcs;
    this.times = data.times;
    this.states = unpack(data.states, this.times.length, 4 * discs.length);
    this.quanta = data.states.quanta;  // of x, y, v_x and v_y
    this.angles = data.angles && unpack(data.angles, this.times.length, discs.length);  // rad; null if none turns
    this.touches = data.touches.map(([a, b, wall, begin, end, x, y]) => ({a, b, wall, begin, end, impulse: [x, y]}));
    this.pushed = data.pushed;
    this.ends = data.ends;  // of the control's intervals, s
    this.control = unpack(data.control, this.ends.length, 2 * data.pushed.length);
    this.torques = data.torques && unpack(data.torques, this.ends.length, data.pushed.length);  // N m; null if no disc is turned
    this.spreads = data.spreads ?? [];
    this.visible = data.shown !== false;
    this.fastest = this.largestOf((i) => Math.hypot(this.states[i + 2], this.states[i + 3]), this.states.length, 4);
    this.strongest = this.largestOf((i) => Math.hypot(this.control[i], this.control[i + 1]), this.control.length, 2);
    this.twisted = this.torques ? this.largestOf((i) => Math.abs(this.torques[i]), this.torques.length, 1) : 0;
    this.hardest = Math.max(0, ...this.touches.slice(0, 10000).map(({impulse}) => Math.hypot(...impulse)));
    this.longestTouch = this.touches.reduce((longest, {begin, end}) => Math.max(longest, end - begin), 0);
  }

  largestOf(value, length, step) {
    let largest = 0;
    for (let i = 0; i < length; i += step) largest = Math.max(largest, value(i));
    return largest;
  }

  // Times and states for drawing paths: those of the rows, and of motions on arcs enough in between. Made once.
  get path() {
    if (this.made) return this.made;
    const width = 4 * this.discs.length, rows = this.times.length, parts = this.arcs ? Math.max(1, Math.ceil(SMOOTH / rows)) : 1;
    if (parts === 1) return (this.made = {times: this.times, states: this.states});
    const times = new Float64Array(parts * (rows - 1) + 1), states = new Float64Array(width * times.length);
    times.forEach((_, i) => {
      const row = Math.floor(i / parts), next = Math.min(row + 1, rows - 1);
      times[i] = this.times[row] + (i % parts) / parts * (this.times[next] - this.times[row]);
      // A row has its own state: of an impact, there are those before and after.
      if (i % parts === 0) states.set(this.states.subarray(row * width, (row + 1) * width), i * width);
      else this.stateAt(times[i], states.subarray(i * width, (i + 1) * width));
    });
    return (this.made = {times, states});
  }

  get end() { return this.times[this.times.length - 1]; }

  // The last row that is not after `time`; of an instant that stands twice the second.
  rowAt(time, times = this.times) {
    let low = 0, high = times.length - 1;
    while (low < high) {
      const middle = (low + high + 1) >> 1;
      if (times[middle] <= time) low = middle;
      else high = middle - 1;
    }
    return low;
  }

  // The row before `time`, how long it is until the next, and which part of that has passed; 0 beyond the end.
  betweenRows(time) {
    const row = this.rowAt(time), step = row + 1 < this.times.length ? this.times[row + 1] - this.times[row] : 0;
    return {row, step, part: step > 0 ? Math.min(Math.max((time - this.times[row]) / step, 0), 1) : 0};
  }

  // The ellipse around a disc's position that has it with a probability of 0.95, m: its half axes, the larger first, and
  // the angle of that. Covariances are linear between two rows.
  ellipseAt({times, covariances}, time, disc) {
    const row = this.rowAt(time, times), width = 3 * this.discs.length, next = Math.min(row + 1, times.length - 1);
    const part = next > row ? Math.min(Math.max((time - times[row]) / (times[next] - times[row]), 0), 1) : 0;
    const [xx, xy, yy] = [0, 1, 2].map((i) => {
      const [from, to] = [row, next].map((at) => covariances[at * width + 3 * disc + i]);
      return from + part * (to - from);
    });
    const mean = (xx + yy) / 2, apart = Math.hypot((xx - yy) / 2, xy), within = -2 * Math.log(0.05);
    return {a: Math.sqrt(within * (mean + apart)), b: Math.sqrt(within * Math.max(mean - apart, 0)), angle: Math.atan2(2 * xy, xx - yy) / 2};
  }

  // p_x p_y v_x v_y of every disc, into `out`. Beyond the end, the last state.
  stateAt(time, out) {
    const {row, step, part} = this.betweenRows(time), width = 4 * this.discs.length, from = row * width;
    if (part === 0) {
      out.set(this.states.subarray(from, from + width));
      return out;
    }
    for (let i = 0; i < width; ++i) {
      const x = this.states[from + i], y = this.states[from + width + i];
      out[i] = x + part * (y - x);
    }
    if (this.arcs) this.bend(from, width, step, part, out);
    return out;
  }

  // The angle of a disc, rad: turning at a constant speed between two rows.
  angleAt(time, disc) {
    const {row, part} = this.betweenRows(time), width = this.discs.length, angle = this.angles[row * width + disc];
    return part === 0 ? angle : angle + part * (this.angles[(row + 1) * width + disc] - angle);
  }

  // Positions on the cubic that positions and velocities at both ends determine: on a parabola, that parabola.
  bend(from, width, step, part, out) {
    const rest = 1 - part, s = this.states;
    for (let i = 0; i < width; i += 4) {
      for (let j = i; j < i + 2; ++j) {
        const p = s[from + j], q = s[from + width + j], v = s[from + j + 2], w = s[from + width + j + 2];
        const chord = q - p;
        out[j] = p + part * chord + part * rest * (rest * (step * v - chord) - part * (step * w - chord));
      }
    }
  }

  // The interval of the control at `time`; -1 if there is none.
  intervalAt(time) {
    if (this.ends.length === 0 || time > this.end) return -1;
    return this.ends[0] > time ? 0 : Math.min(this.rowAt(time, this.ends) + 1, this.ends.length - 1);
  }

  // [disc, force x, force y] of every disc that is pushed.
  forcesAt(time) {
    const k = this.intervalAt(time), width = 2 * this.pushed.length;
    if (k < 0) return [];
    return this.pushed.map((disc, c) => [disc, this.control[k * width + 2 * c], this.control[k * width + 2 * c + 1]]);
  }

  // [disc, torque] of every disc that is turned.
  torquesAt(time) {
    const k = this.intervalAt(time);
    if (k < 0 || !this.torques) return [];
    return this.pushed.map((disc, c) => [disc, this.torques[k * this.pushed.length + c]]).filter(([, torque]) => torque !== 0);
  }

  // What touches at `time`, or did up to `memory` seconds before, with its `age` from 0 (now) to 1.
  touchesAt(time, memory) {
    const found = [];
    let low = 0, high = this.touches.length;
    const earliest = time - memory - this.longestTouch;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (this.touches[middle].begin < earliest) low = middle + 1;
      else high = middle;
    }
    for (let i = low; i < this.touches.length && this.touches[i].begin <= time; ++i) {
      const age = (time - this.touches[i].end) / memory;
      if (age <= 1) found.push({...this.touches[i], age: Math.max(age, 0)});
    }
    return found;
  }
}
