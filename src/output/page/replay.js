// A replay: its controls, keyboard and clock.
const STILLS = 6, VALUES_OF_AT_MOST = 12;
const DRAG = 6;  // pixels: what moves less is a tap
const OPTIONS = [
  ['paths', 'whole paths'], ['trails', 'trails'], ['velocities', 'velocities'], ['forces', 'forces'], ['touches', 'contacts'],
  ['impulses', 'impulses'], ['names', 'names'], ['spreads', '95 % ellipses'], ['apart', 'side by side'],
];
const VALUES = ['motion', 'disc', 'x (m)', 'y (m)', 'v_x (m/s)', 'v_y (m/s)'];
const KEYS = 'Keys: space plays and pauses, arrows step (with shift from impact to impact), Home and End. ' +
  'On the picture a tap plays and pauses, and a drag to the side moves through time';

function element(name, attributes = {}, ...children) {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) {
    if (key.startsWith('on')) made.addEventListener(key.slice(2), value);
    else made.setAttribute(key, value);
  }
  made.append(...children);
  return made;
}

function number(value) {
  return Number.isFinite(value) ? value.toPrecision(10).replace(/\.?0+(?=$|e)/, '') : '–';
}

// A value that is stored as a multiple of `quantum`, with the decimals that it has.
function rounded(value, quantum) {
  const decimals = Math.min(Math.max(Math.floor(-Math.log10(quantum)), 0), 15);
  return number(Number(value.toFixed(decimals)));
}

// A time from 0 to `duration` that goes on while it is played, the button that starts and stops it, a slider and a clock.
// Classes that extend this one have seek(time), which draws, and set `duration` and the slider's maximum to it.
class Player {
  constructor() {
    this.time = 0;
    this.playing = false;
    this.playButton = element('button', {type: 'button', title: 'play', 'aria-label': 'play', onclick: () => this.toggle()}, 'Play');
    this.slider = element('input', {type: 'range', min: 0, step: 'any', value: 0, 'aria-label': 'time',
      oninput: () => this.seek(Number(this.slider.value))});
    this.clock = element('output', {class: 'clock'});
  }

  // Seconds of the motion in a second.
  get rate() { return 1; }

  toggle() {
    if (!this.playing && this.time >= this.duration) this.seek(0);
    this.playing = !this.playing;
    this.playButton.textContent = this.playing ? 'Pause' : 'Play';
    this.playButton.title = this.playing ? 'pause' : 'play';
    this.playButton.setAttribute('aria-label', this.playButton.title);
    this.last = performance.now();
    if (this.playing) requestAnimationFrame((now) => this.advance(now));
  }

  advance(now) {
    if (!this.playing) return;
    const passed = Math.max(now - this.last, 0) / 1000;
    this.last = now;
    this.seek(this.time + this.rate * passed);
    if (this.time >= this.duration) this.toggle();
    else requestAnimationFrame((next) => this.advance(next));
  }

  pause() {
    if (this.playing) this.toggle();
  }
}

class Replay extends Player {
  // In place of an element that is in the page; the data are those of ReplayToJson() in programs/scene_drawing.h.
  constructor(place, data) {
    super();
    const {discs, walls, outlines, targets} = data;
    Object.assign(this, {place, discs, walls, outlines, targets});
    this.motions = data.motions.map((motion) => new Motion(motion, data));
    const most = (value) => Math.max(0, ...this.motions.map(value));
    this.fastest = most((motion) => motion.fastest);
    this.strongest = most((motion) => motion.strongest);
    this.twisted = most((motion) => motion.twisted);
    this.hardest = most((motion) => motion.hardest);
    this.duration = most((motion) => motion.end);
    this.enlarged = this.enlargementOf();
    this.memory = 0.04 * this.duration;
    this.impacts = [...new Set(this.motions.flatMap(({touches}) => touches.map(({begin}) => begin)))].sort((a, b) => a - b);
    this.options = {
      paths: this.discs.length <= MANY_DISCS, trails: this.discs.length <= MANY_DISCS, velocities: false, forces: this.strongest + this.twisted > 0, touches: true,
      impulses: this.discs.length <= MANY_DISCS,
      names: true, spreads: true, apart: false,
    };
    this.build();
    this.view = new View(this.canvas, this);
    this.updateValueRows();
    this.redraw();
    new ResizeObserver(() => this.redraw()).observe(this.stage);
    window.addEventListener('beforeprint', () => this.makeStills());
    this.seek(0);
  }

  // How many times larger than they are ellipses are drawn: 1, 2, 5, 10, ... so that the largest reaches half of the largest disc's
  // radius, if it is smaller. 0 if there are none.
  enlargementOf() {
    let largest = 0;
    for (const motion of this.motions) {
      for (const spread of motion.spreads) {
        for (const time of spread.times) this.discs.forEach((_, i) => { largest = Math.max(largest, motion.ellipseAt(spread, time, i).a); });
      }
    }
    if (largest === 0) return 0;
    const ratio = 0.5 * Math.max(...this.discs.map(({radius}) => radius)) / largest, decade = 10 ** Math.floor(Math.log10(ratio));
    return ratio < 2 ? 1 : decade * [5, 2, 1].find((multiple) => multiple * decade <= ratio);
  }

  build() {
    this.canvas = element('canvas', {
      role: 'img', 'aria-label': this.describe(), tabindex: 0, onpointerdown: (event) => this.grip(event),
      onpointermove: (event) => this.drag(event), onpointerup: () => this.release(true),
      onpointercancel: () => this.release(false),
    });
    this.slider.max = this.duration;
    this.ticks = element('canvas', {class: 'ticks', 'aria-hidden': 'true'});
    const button = (label, words, act) => element('button', {type: 'button', title: words, 'aria-label': words, onclick: act}, label);
    this.speed = element('select', {'aria-label': 'speed'});
    for (let power = -6; power <= 3; ++power) {
      const factor = 2 ** power;
      this.speed.append(element('option', {value: factor}, `${power < 0 ? `1/${2 ** -power}` : factor} ×`));
    }
    // About six seconds from start to end.
    this.speed.value = 2 ** Math.min(Math.max(Math.round(Math.log2(this.duration / 6 || 1)), -6), 3);
    const buttons = element('div', {class: 'buttons'},
      this.playButton, button('|◀', 'to the start', () => this.seek(0)),
      button('−', 'one step back', () => this.step(-1)), button('+', 'one step on', () => this.step(1)),
      button('◀ impact', 'previous impact', () => this.jump(-1)), button('impact ▶', 'next impact', () => this.jump(1)),
      element('label', {}, 'speed ', this.speed), this.clock);
    this.stage = element('div', {class: 'stage'}, this.canvas);
    this.player = element('div', {class: 'player', title: KEYS, onkeydown: (event) => this.press(event)},
      this.stage, buttons, element('div', {class: 'line'}, this.slider, this.ticks), this.buildLegend(), this.buildOptions());
    this.values = element('tbody');
    this.valuesPart = element('details', {class: 'values', ontoggle: () => this.updateValues()},
      element('summary', {}, 'Positions and velocities at this time'),
      element('div', {class: 'scroll', tabindex: 0}, element('table', {},
        element('thead', {}, element('tr', {}, ...VALUES.map((name, j) => element('th', {scope: 'col', class: j < 2 ? 'key' : 'number'}, name)))), this.values)));
    this.player.append(this.valuesPart);
    this.stills = element('div', {class: 'stills'});
    this.place.replaceWith(this.player, this.stills);
  }

  buildLegend() {
    const legend = element('div', {class: 'legend', role: 'group', 'aria-label': 'motions'});
    for (const motion of this.motions) {
      const box = element('input', {type: 'checkbox', onchange: () => { motion.visible = box.checked; this.redraw(); }});
      box.checked = motion.visible;
      motion.box = box;
      const key = svg('svg', {width: 30, height: 10, 'aria-hidden': true}, svg('line', {
        x1: 1, x2: 29, y1: 5, y2: 5, stroke: motion.colour, 'stroke-width': 3, 'stroke-dasharray': DASHES[motion.dash].join(' ')}));
      const remark = motion.remark ? element('span', {class: 'remark'}, ` (${motion.remark})`) : '';
      legend.append(element('label', {}, box, key, ` ${motion.label}`, remark));
    }
    return legend;
  }

  buildOptions() {
    const group = element('div', {class: 'options', role: 'group', 'aria-label': 'what is drawn'});
    for (const [key, words] of OPTIONS) {
      if (key === 'apart' && this.motions.length < 2) continue;
      if (key === 'forces' && this.strongest + this.twisted === 0) continue;
      if (key === 'spreads' && this.enlarged === 0) continue;
      const box = element('input', {type: 'checkbox', onchange: () => { this.options[key] = box.checked; this.redraw(); }});
      box.checked = this.options[key];
      group.append(element('label', {}, box, ` ${words}${key === 'spreads' && this.enlarged > 1 ? `, enlarged ${this.enlarged} times` : ''}`));
    }
    return group;
  }

  // What it shows, for those who do not see it.
  describe() {
    const named = (list, words) => list.slice(0, 6).map(words).join(', ') + (list.length > 6 ? `, and ${list.length - 6} more` : '');
    const planes = this.walls.filter(({kind}) => kind === 'half-plane').length;
    const motions = this.motions.map(({label, end, touches, states}) => {
      const contacts = named(touches, ({a, b, wall, begin}) => (
        `contact of ${this.discs[a].name} and ${(wall ? this.walls : this.discs)[b].name} at ${begin.toPrecision(4)} s`));
      const last = states.length - 4 * this.discs.length, moving = this.discs.map((_, i) => i).filter((i) => !this.discs[i].fixed);
      const ends = named(moving, (i) => `${this.discs[i].name} at (${states[last + 4 * i].toPrecision(4)}, ${states[last + 4 * i + 1].toPrecision(4)}) m`);
      return ` ${label}, ${end.toPrecision(4)} s: ${contacts || 'no contact'}${ends && `; at the end ${ends}`}.`;
    });
    return `Discs: ${this.discs.length}, walls: ${planes + this.outlines.length}.${motions.join('')}`;
  }

  // One motion alone at a time, where the reader sees it.
  show(label, time) {
    this.pause();
    for (const motion of this.motions) motion.visible = motion.box.checked = motion.label === label;
    this.redraw();
    this.seek(time);
    this.player.scrollIntoView({block: 'center'});
  }

  seek(time) {
    this.time = Math.min(Math.max(time, 0), this.duration);
    this.slider.value = this.time;
    this.slider.setAttribute('aria-valuetext', `${number(this.time)} s`);
    this.clock.value = `${this.time.toFixed(4)} s`;
    this.drawFrame();
  }

  drawFrame() {
    this.view.draw(this.time, this.options);
    this.updateValues();
  }

  // Where its size may be another.
  redraw() {
    this.view.resize(this.options);
    this.drawTicks();
    this.drawFrame();
  }

  // A row of impacts for each motion, under the slider.
  drawTicks() {
    const width = this.ticks.clientWidth, rows = this.motions.length, height = 5 * rows + 2;
    if (width === this.ticksWidth) return;
    this.ticksWidth = width;
    const ratio = window.devicePixelRatio || 1;
    this.ticks.width = width * ratio;
    this.ticks.height = height * ratio;
    this.ticks.style.height = `${height}px`;
    const context = this.ticks.getContext('2d');
    context.scale(ratio, ratio);
    this.motions.forEach((motion, row) => {
      context.fillStyle = motion.colour;
      for (const {begin, end} of motion.touches) {
        const x = width * begin / this.duration;
        context.fillRect(x - 1, 5 * row + 1, Math.max(2, width * (end - begin) / this.duration), 4);
      }
    });
  }

  updateValueRows() {
    this.cells = [];
    const discs = this.discs.slice(0, VALUES_OF_AT_MOST);
    for (const motion of this.motions) {
      discs.forEach((disc, i) => {
        const row = VALUES.map((name) => element('td', {'data-label': name})), cells = row.slice(2);
        row[0].append(motion.label);
        row[1].append(disc.name);
        row.slice(0, 2).forEach((cell) => cell.classList.add('key'));
        cells.forEach((cell) => cell.classList.add('number'));
        this.values.append(element('tr', {}, ...row));
        this.cells.push({motion, i, cells});
      });
    }
    this.state = new Float64Array(4 * this.discs.length);
  }

  updateValues() {
    if (!this.valuesPart.open) return;
    let last = null;
    for (const {motion, i, cells} of this.cells) {
      if (motion !== last) motion.stateAt(this.time, this.state);
      last = motion;
      cells.forEach((cell, j) => { cell.textContent = rounded(this.state[4 * i + j], motion.quanta[j]); });
    }
  }

  get rate() { return Number(this.speed.value); }

  // 240 steps from start to end.
  step(direction) {
    this.pause();
    this.seek(this.time + direction * this.duration / 240);
  }

  // To the next or previous impact, of whatever motion.
  jump(direction) {
    this.pause();
    const margin = 1e-9 * this.duration;
    const found = direction > 0 ? this.impacts.find((time) => time > this.time + margin)
                                : this.impacts.filter((time) => time < this.time - margin).pop();
    this.seek(found ?? (direction > 0 ? this.duration : 0));
  }

  press(event) {
    if (event.altKey || event.ctrlKey || event.metaKey) return;
    const onControl = ['SELECT', 'SUMMARY'].includes(event.target.tagName);
    const acts = {
      ' ': () => this.toggle(),
      ArrowRight: () => (event.shiftKey ? this.jump(1) : this.step(1)),
      ArrowLeft: () => (event.shiftKey ? this.jump(-1) : this.step(-1)),
      Home: () => this.seek(0),
      End: () => this.seek(this.duration),
    };
    const pressesItself = event.key === ' ' && ['BUTTON', 'INPUT'].includes(event.target.tagName) && event.target !== this.slider;
    if (onControl || pressesItself || !acts[event.key]) return;
    event.preventDefault();
    acts[event.key]();
  }

  // By mouse, pen or finger, which goes on where it leaves the picture. What moves up or down scrolls the page.
  grip(event) {
    if (event.button !== 0) return;
    this.gripped = {x: event.clientX, drags: false};
    this.canvas.setPointerCapture(event.pointerId);
  }

  drag({clientX}) {
    const {gripped} = this;
    if (!gripped) return;
    if (!gripped.drags) {
      if (Math.abs(clientX - gripped.x) < DRAG) return;
      this.pause();
      Object.assign(gripped, {drags: true, time: this.time});
    }
    this.seek(gripped.time + this.duration * (clientX - gripped.x) / this.canvas.clientWidth);
  }

  release(lifted) {
    const tapped = lifted && this.gripped && !this.gripped.drags;
    this.gripped = null;
    if (tapped) this.toggle();
  }

  // Still frames for paper: equal parts of the time.
  makeStills() {
    this.stills.replaceChildren();
    for (let i = 0; i < STILLS; ++i) {
      const time = this.duration * i / (STILLS - 1), canvas = element('canvas');
      const width = 360, height = Math.round(width * this.view.aspect);
      canvas.width = 2 * width;
      canvas.height = 2 * height;
      const view = Object.assign(Object.create(View.prototype), this.view, {canvas});
      view.draw(time, {...this.options, apart: false}, width, height);
      this.stills.append(element('div', {}, element('img', {src: canvas.toDataURL(), alt: ''}), `${number(time)} s`));
    }
  }
}
