// Draws motions on a canvas, for white paper; on a dark screen the style sheet inverts it.
const INK = '#24292f', FAINT = '#8b949e', GROUND = '#d8dee4', FORCE = '#0b6e4f', IMPULSE = '#b3261e', SPREAD = '#7c3aed';
const DASHES = {solid: [], dashed: [6, 4], dotted: [2, 3], dashdotted: [7, 3, 2, 3]};
const MANY_DISCS = 60, AGES = 5;
const ARROW = 0.14;  // of the scene's extent, the longest
const DISC_COLOURS = ['#2f81f7', '#d9730d', '#2da44e', '#a475f9', '#db61a2', '#b08800'];

class View {
  constructor(canvas, replay) {
    this.canvas = canvas;
    this.replay = replay;
    this.bounds = this.boundsOf(replay);
    this.extent = Math.hypot(this.bounds.right - this.bounds.left, this.bounds.top - this.bounds.bottom);
    this.scratch = new Float64Array(4 * replay.discs.length);
    this.stamps = new Map();
  }

  // All that discs, walls that end, targets and the visible motions reach, and planes that are no farther from these than their size.
  boundsOf({motions, targets}) {
    const box = {left: Infinity, right: -Infinity, bottom: Infinity, top: -Infinity};
    const add = (x, y, r) => {
      box.left = Math.min(box.left, x - r);
      box.right = Math.max(box.right, x + r);
      box.bottom = Math.min(box.bottom, y - r);
      box.top = Math.max(box.top, y + r);
    };
    for (const {states, discs, outlines} of motions) {
      for (const {points} of outlines) points.forEach(([x, y]) => add(x, y, 0));
      for (let i = 0, disc = 0; i < states.length; i += 4, disc = (disc + 1) % discs.length) {
        if (Number.isFinite(states[i] + states[i + 1])) add(states[i], states[i + 1], discs[disc].radius);
      }
    }
    for (const target of targets) add(target[0], target[1], 0);
    if (!(box.right >= box.left)) return {left: -1, right: 1, bottom: -1, top: 1};
    const middle = [(box.left + box.right) / 2, (box.bottom + box.top) / 2], reach = Math.max(box.right - box.left, box.top - box.bottom);
    for (const wall of this.walls.filter(({kind}) => kind === 'half-plane')) {
      const [px, py] = this.contactWith(wall, ...middle);
      if (Math.hypot(px - middle[0], py - middle[1]) <= 1.5 * reach) add(px, py, 0);
    }
    const margin = 0.06 * Math.max(box.right - box.left, box.top - box.bottom, 1e-300);
    return {left: box.left - margin, right: box.right + margin, bottom: box.bottom - margin, top: box.top + margin};
  }

  get aspect() {
    const ratio = (this.bounds.top - this.bounds.bottom) / (this.bounds.right - this.bounds.left);
    return Math.min(Math.max(ratio, 0.3), 1.4);
  }

  // Motions that are drawn, in the cells they are drawn in.
  cells(width, options) {
    const shown = this.replay.motions.filter((motion) => motion.visible);
    if (!options.apart || shown.length < 2) return [{motions: shown, columns: 1, rows: 1, column: 0, row: 0}];
    const columns = Math.max(1, Math.min(shown.length, Math.floor(width / 240)));
    const rows = Math.ceil(shown.length / columns);
    return shown.map((motion, i) => ({motions: [motion], columns, rows, column: i % columns, row: Math.floor(i / columns)}));
  }

  // The canvas as high as its cells are, at most as the window. Asks for sizes, which takes time: not in every frame.
  resize(options) {
    const width = this.canvas.clientWidth || 600, [cell] = this.cells(width, options);
    const most = Math.max(220, 0.72 * window.innerHeight);
    const height = Math.min(cell.rows * Math.max(160, this.aspect * width / cell.columns), cell.rows > 1 ? 2 * most : most);
    const ratio = window.devicePixelRatio || 1;
    this.canvas.style.height = `${height}px`;
    Object.assign(this, {width, height});
    if (this.canvas.width === Math.round(width * ratio) && this.canvas.height === Math.round(height * ratio)) return;
    this.stamps.clear();  // discs have other sizes
    this.canvas.width = Math.round(width * ratio);
    this.canvas.height = Math.round(height * ratio);
  }

  draw(time, options, width = this.width, height = this.height) {
    const context = this.canvas.getContext('2d');
    const ratio = this.canvas.width / Math.max(width, 1);
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, width, height);
    this.placeWalls(time);
    for (const cell of this.cells(width, options)) this.drawCell(context, cell, time, options, width, height);
  }

  drawCell(context, cell, time, options, width, height) {
    const w = width / cell.columns, h = height / cell.rows, x = cell.column * w, y = cell.row * h;
    const {left, right, bottom, top} = this.bounds;
    const scale = Math.min(w / (right - left), h / (top - bottom));
    const origin = [x + w / 2 - scale * (left + right) / 2, y + h / 2 + scale * (bottom + top) / 2];
    this.toX = (px) => origin[0] + scale * px;
    this.toY = (py) => origin[1] - scale * py;
    this.scale = scale;
    context.save();
    context.beginPath();
    context.rect(x, y, w, h);
    context.clip();
    const [first = this.replay, ...others] = cell.motions;
    this.drawWalls(context, first, [x, y, w, h], FAINT, GROUND);
    for (const {walls, outlines, colour} of others) {
      const moved = {walls: walls.filter((wall, i) => wall !== first.walls[i]), outlines: outlines.filter((line, i) => line !== first.outlines[i])};
      this.drawWalls(context, moved, [x, y, w, h], colour);
    }
    this.drawTargets(context);
    if (this.replay.discs.length > MANY_DISCS) this.drawManyDiscs(context, cell.motions, time);
    cell.motions.forEach((motion, i) => this.drawMotion(context, motion, time, options, i === 0));
    context.restore();
    if (cell.columns * cell.rows > 1) {
      context.strokeStyle = GROUND;
      context.strokeRect(x + 0.5, y + 0.5, w - 1, h - 1);
      this.text(context, cell.motions[0].label, x + 8, y + 18, 'left');
    }
  }

  // Discs of a replay of one motion have a colour each; of several motions each has that of its motion.
  colourOf(motion, disc) {
    return this.replay.motions.length === 1 && this.replay.discs.length <= MANY_DISCS ? DISC_COLOURS[disc % DISC_COLOURS.length] : motion.colour;
  }

  text(context, words, x, y, align = 'center') {
    context.font = '12px system-ui, sans-serif';
    context.textAlign = align;
    context.lineWidth = 3;
    context.strokeStyle = '#ffffff';
    context.strokeText(words, x, y);
    context.fillStyle = INK;
    context.fillText(words, x, y);
  }

  // All walls: motions may have different ones.
  get walls() {
    return [...new Set(this.replay.motions.flatMap(({walls}) => walls))];
  }

  // Puts walls that have a prescribed motion where they are at that time.
  placeWalls(time) {
    for (const wall of this.walls.filter(({motion}) => motion)) {
      const {times, points} = wall.motion, next = Math.max(1, times.findIndex((t, i) => t >= time || i === times.length - 1));
      const [from, to] = [points[next - 1], points[next]], part = (time - times[next - 1]) / (times[next] - times[next - 1]);
      wall.point = [0, 1].map((j) => from[j] + part * (to[j] - from[j]));
    }
  }

  // Draws walls in a cell [x, y, width, height]: lines, and what is solid if `ground` is its colour.
  drawWalls(context, {walls, outlines}, cell, line, ground = null) {
    context.strokeStyle = line;
    context.fillStyle = ground ?? 'transparent';
    context.lineWidth = 1.5;
    this.drawOutlines(context, outlines, cell);
    for (const wall of walls) {
      if (wall.kind !== 'half-plane') continue;
      const far = 4 * (cell[2] + cell[3]) / this.scale, [nx, ny] = wall.normal;
      const centre = this.nearestTo(wall);
      const corner = (along, depth) => [centre[0] - ny * along - nx * depth, centre[1] + nx * along - ny * depth];
      const corners = [corner(-far, 0), corner(far, 0), corner(far, far), corner(-far, far)];
      context.beginPath();
      corners.forEach(([px, py]) => context.lineTo(this.toX(px), this.toY(py)));
      context.closePath();
      context.fill();
      context.beginPath();
      context.moveTo(this.toX(corners[0][0]), this.toY(corners[0][1]));
      context.lineTo(this.toX(corners[1][0]), this.toY(corners[1][1]));
      context.stroke();
    }
  }

  // What is solid outside of a line first: it would cover all else.
  drawOutlines(context, outlines, cell) {
    for (const solid of ['outside', 'inside']) {
      for (const outline of outlines.filter((one) => one.solid === solid)) {
        context.beginPath();
        if (solid === 'outside') context.rect(...cell);
        this.trace(context, outline);
        context.fill('evenodd');
      }
    }
    context.beginPath();
    for (const outline of outlines) this.trace(context, outline);
    context.stroke();
  }

  trace(context, {points}) {
    points.forEach(([px, py], i) => {
      if (i === 0) context.moveTo(this.toX(px), this.toY(py));
      else context.lineTo(this.toX(px), this.toY(py));
    });
  }

  // The point of a wall where a disc at (x, y) touches it.
  contactWith({kind, point, normal, radius}, x, y) {
    const dx = x - point[0], dy = y - point[1];
    if (kind === 'circle') {
      const share = radius / (Math.hypot(dx, dy) || 1);
      return [point[0] + share * dx, point[1] + share * dy];
    }
    const gap = dx * normal[0] + dy * normal[1];
    return [x - gap * normal[0], y - gap * normal[1]];
  }

  // The point of a wall next to the middle of what is drawn.
  nearestTo(wall) {
    const {left, right, bottom, top} = this.bounds;
    return this.contactWith(wall, (left + right) / 2, (bottom + top) / 2);
  }

  drawTargets(context) {
    context.strokeStyle = INK;
    context.lineWidth = 1.5;
    for (const [px, py] of this.replay.targets) {
      const x = this.toX(px), y = this.toY(py);
      context.beginPath();
      context.moveTo(x - 6, y);
      context.lineTo(x + 6, y);
      context.moveTo(x, y - 6);
      context.lineTo(x, y + 6);
      context.stroke();
    }
  }

  drawMotion(context, motion, time, options, first) {
    const x = motion.stateAt(time, this.scratch);
    const {times} = motion.path;
    if (options.paths) this.drawPaths(context, motion, times.length - 1, 0.6, 0.75);
    if (options.trails) this.drawPaths(context, motion, motion.rowAt(time, times), 0.7, 1.5);
    if (this.replay.discs.length <= MANY_DISCS) this.drawDiscs(context, motion, x, first);
    if (motion.angles) this.drawSpokes(context, motion, x, time);
    if (options.spreads) motion.spreads.forEach((spread, i) => this.drawSpread(context, motion, spread, i, x, time));
    if (options.touches) this.drawTouches(context, motion, x, time, options);
    const {fastest, strongest} = this.replay, {discs} = motion;
    const arrow = (i, unit, ax, ay) => [x[4 * i], x[4 * i + 1], unit * ax, unit * ay];
    if (options.velocities) {
      const unit = ARROW * this.extent / (fastest || 1), moving = discs.map((_, i) => i).filter((i) => !discs[i].fixed);
      this.drawArrows(context, moving.map((i) => arrow(i, unit, x[4 * i + 2], x[4 * i + 3])), motion.colour);
    }
    if (options.forces) {
      const unit = ARROW * this.extent / (strongest || 1);
      this.drawArrows(context, motion.forcesAt(time).map(([i, fx, fy]) => arrow(i, unit, fx, fy)), FORCE);
      this.drawTorques(context, motion, motion.torquesAt(time), x);
    }
    if (options.names && first && discs.length <= MANY_DISCS) {
      discs.forEach((disc, i) => {
        this.text(context, disc.name, this.toX(x[4 * i]), this.toY(x[4 * i + 1]) - this.scale * disc.radius - 5);
      });
    }
  }

  // Discs that are too many for a path each, those that are fixed below the others.
  drawManyDiscs(context, motions, time) {
    const ratio = context.getTransform().a, x = this.scratch;
    motions.forEach((motion, i) => {
      const {discs} = motion;
      motion.stateAt(time, x);
      for (const fixed of [true, false]) {
        discs.forEach((disc, j) => {
          if (disc.fixed !== fixed || !Number.isFinite(x[4 * j])) return;
          const at = [ratio * this.toX(x[4 * j]), ratio * this.toY(x[4 * j + 1])], [left, top] = at.map(Math.floor);
          const part = at.map((pixel) => Math.floor(4 * (pixel - Math.floor(pixel))) / 4);
          const stamp = this.stampOf(fixed ? FAINT : motion.colour, i === 0, Math.max(ratio * this.scale * disc.radius, 1), part, ratio);
          const size = stamp.width / ratio;
          context.drawImage(stamp, left / ratio - size / 2, top / ratio - size / 2, size, size);
        });
      }
    });
  }

  // A disc as a picture, in pixels of the screen, which is painted once for each colour, size and quarter of a pixel.
  stampOf(colour, first, radius, [dx, dy], ratio) {
    const key = `${colour} ${first} ${radius.toFixed(2)} ${dx} ${dy}`;
    if (!this.stamps.has(key)) {
      const stamp = element('canvas'), middle = Math.ceil(radius) + 2;
      stamp.width = stamp.height = 2 * middle;
      const context = stamp.getContext('2d');
      context.beginPath();
      context.arc(middle + dx, middle + dy, radius, 0, 2 * Math.PI);
      this.paint(context, colour, first, radius > 6 * ratio ? 2 * ratio : ratio, []);
      this.stamps.set(key, stamp);
    }
    return this.stamps.get(key);
  }

  paint(context, colour, first, width, dash) {
    context.globalAlpha = first ? 0.28 : 0.08;
    context.fillStyle = colour;
    context.fill();
    context.globalAlpha = 1;
    context.strokeStyle = colour;
    context.lineWidth = width;
    context.setLineDash(dash);
    context.stroke();
    context.setLineDash([]);
  }

  // The discs of a motion; those that are fixed grey. Ghosts are outlines.
  drawDiscs(context, motion, x, first) {
    motion.discs.forEach((disc, i) => {
      if (!Number.isFinite(x[4 * i])) return;
      context.beginPath();
      context.arc(this.toX(x[4 * i]), this.toY(x[4 * i + 1]), Math.max(this.scale * disc.radius, 1), 0, 2 * Math.PI);
      this.paint(context, disc.fixed ? FAINT : this.colourOf(motion, i), first, 2, DASHES[motion.dash]);
    });
  }

  // From the centre of each disc to the point of its rim that began to the right.
  drawSpokes(context, motion, x, time) {
    context.lineWidth = 2;
    motion.discs.forEach((disc, i) => {
      if (disc.fixed) return;
      context.beginPath();
      const angle = motion.angleAt(time, i), px = this.toX(x[4 * i]), py = this.toY(x[4 * i + 1]);
      context.moveTo(px, py);
      context.lineTo(px + this.scale * disc.radius * Math.cos(angle), py - this.scale * disc.radius * Math.sin(angle));
      context.strokeStyle = this.colourOf(motion, i);
      context.stroke();
    });
  }

  // Ellipses of where discs are with a probability of 0.95: the first filled, others dashed, enlarged as the caption says.
  drawSpread(context, motion, spread, index, x, time) {
    const unit = this.scale * this.replay.enlarged;
    context.beginPath();
    motion.discs.forEach((disc, i) => {
      const {a, b, angle} = motion.ellipseAt(spread, time, i);
      if (!(a > 0)) return;
      const px = this.toX(x[4 * i]), py = this.toY(x[4 * i + 1]);
      context.moveTo(px + unit * a * Math.cos(angle), py - unit * a * Math.sin(angle));
      context.ellipse(px, py, unit * a, unit * b, -angle, 0, 2 * Math.PI);
    });
    context.strokeStyle = context.fillStyle = SPREAD;
    context.lineWidth = 1.5;
    context.globalAlpha = 0.25;
    if (index === 0) context.fill();
    context.globalAlpha = 1;
    context.setLineDash(index === 0 ? [] : DASHES.dashed);
    context.stroke();
    context.setLineDash([]);
  }

  // Where discs are up to a point of their paths and, if that is not the last, now; of many discs only lately.
  drawPaths(context, motion, last, opacity, lineWidth) {
    const {discs} = motion, width = 4 * discs.length, {times, states} = motion.path;
    const begin = discs.length > MANY_DISCS ? Math.max(0, last - 24) : 0;
    const every = Math.max(1, Math.ceil((last - begin) / 1000));
    context.globalAlpha = opacity;
    context.lineWidth = lineWidth;
    context.setLineDash(discs.length > MANY_DISCS ? [] : DASHES[motion.dash]);
    discs.forEach((disc, i) => {
      if (disc.fixed) return;
      context.beginPath();
      for (let row = begin; row <= last; row += every) {
        const px = this.toX(states[row * width + 4 * i]), py = this.toY(states[row * width + 4 * i + 1]);
        if (row === begin) context.moveTo(px, py);
        else context.lineTo(px, py);
      }
      if (last < times.length - 1) context.lineTo(this.toX(this.scratch[4 * i]), this.toY(this.scratch[4 * i + 1]));
      context.strokeStyle = this.colourOf(motion, i);
      context.stroke();
    });
    context.setLineDash([]);
    context.globalAlpha = 1;
  }

  // Where two touch. A ring that widens, no blinking; and the impulse on the first disc, or on the second if that one
  // is fixed. Drawn by age, the oldest first and faintest.
  drawTouches(context, motion, x, time, options) {
    const ages = Array.from({length: AGES}, () => []);
    for (const touch of motion.touchesAt(time, this.replay.memory)) ages[Math.min(Math.floor(AGES * touch.age), AGES - 1)].push(touch);
    for (let age = AGES - 1; age >= 0; --age) {
      if (ages[age].length === 0) continue;
      context.globalAlpha = 1 - 0.8 * age / AGES;
      context.beginPath();
      for (const touch of ages[age]) this.traceRing(context, motion, touch, x);
      context.strokeStyle = IMPULSE;
      context.lineWidth = 2.5;
      context.stroke();
      if (options.impulses) this.drawArrows(context, ages[age].map((touch) => this.impulseArrow(touch, x)), IMPULSE);
    }
    context.globalAlpha = 1;
  }

  traceRing(context, {discs, walls}, {a, b, wall, age}, x) {
    const ax = x[4 * a], ay = x[4 * a + 1];
    let px, py;
    if (wall) {
      [px, py] = this.contactWith(walls[b], ax, ay);
    } else {
      const share = discs[a].radius / (discs[a].radius + discs[b].radius);
      px = ax + share * (x[4 * b] - ax);
      py = ay + share * (x[4 * b + 1] - ay);
    }
    const radius = 4 + 8 * age, left = this.toX(px), top = this.toY(py);
    context.moveTo(left + radius, top);
    context.arc(left, top, radius, 0, 2 * Math.PI);
  }

  impulseArrow({a, b, wall, impulse}, x) {
    const moved = this.replay.discs[a].fixed && !wall, at = moved ? b : a;
    const unit = (moved ? -1 : 1) * ARROW * this.extent / (this.replay.hardest || 1);
    return [x[4 * at], x[4 * at + 1], unit * impulse[0], unit * impulse[1]];
  }

  // Arcs around discs, from the right and as long as the torque is large, with a head where they point.
  drawTorques(context, {discs}, torques, x) {
    context.strokeStyle = context.fillStyle = FORCE;
    context.lineWidth = 2;
    for (const [i, torque] of torques) {
      const angle = 1.5 * Math.PI * torque / this.replay.twisted, radius = this.scale * discs[i].radius + 4;
      const left = this.toX(x[4 * i]), top = this.toY(x[4 * i + 1]), side = Math.sign(torque);
      context.beginPath();
      context.arc(left, top, radius, 0, -angle, torque > 0);
      context.stroke();
      const tipX = left + radius * Math.cos(angle), tipY = top - radius * Math.sin(angle);
      const alongX = -side * Math.sin(angle), alongY = -side * Math.cos(angle), head = 5;
      context.beginPath();
      context.moveTo(tipX + head * alongX, tipY + head * alongY);
      context.lineTo(tipX - head * alongY, tipY + head * alongX);
      context.lineTo(tipX + head * alongY, tipY - head * alongX);
      context.fill();
    }
  }

  // Arrows from (x, y), as long as (dx, dy): all shafts, then all heads.
  drawArrows(context, arrows, colour) {
    const tips = [];
    context.beginPath();
    for (const [px, py, dx, dy] of arrows) {
      const x = this.toX(px), y = this.toY(py), tipX = this.toX(px + dx), tipY = this.toY(py + dy);
      const length = Math.hypot(tipX - x, tipY - y);
      if (!(length > 2)) continue;
      const head = Math.min(7, length / 2), hx = head * (tipX - x) / length, hy = head * (tipY - y) / length;
      context.moveTo(x, y);
      context.lineTo(tipX - hx, tipY - hy);
      tips.push([tipX, tipY, hx, hy]);
    }
    context.strokeStyle = colour;
    context.lineWidth = 2;
    context.stroke();
    context.beginPath();
    for (const [x, y, hx, hy] of tips) {
      context.moveTo(x, y);
      context.lineTo(x - hx - 0.5 * hy, y - hy + 0.5 * hx);
      context.lineTo(x - hx + 0.5 * hy, y - hy - 0.5 * hx);
      context.closePath();
    }
    context.fillStyle = colour;
    context.fill();
  }
}
