// Many small discs as stamps in one picture: a thousand paths a frame are slow.
const PARTS = 4;  // of a pixel, in which a disc may begin
const MOST_STAMPS = 20000;

// One colour over another, both with opacities.
function blend(upper, lower) {
  const a = upper >>> 24, rest = (255 - a) * (lower >>> 24) / 255, share = a / (a + rest);
  const red = lower & 255, green = lower >>> 8 & 255, blue = lower >>> 16 & 255;
  return (a + rest + 0.5 | 0) << 24 | (blue + share * ((upper >>> 16 & 255) - blue) | 0) << 16 |
      (green + share * ((upper >>> 8 & 255) - green) | 0) << 8 | (red + share * ((upper & 255) - red) | 0);
}

class StampedDiscs {
  constructor() {
    this.stamps = new Map();  // by colour and opacity; then by size and place in the pixel
    this.canvas = document.createElement('canvas');
    this.context = this.canvas.getContext('2d', {willReadFrequently: true});
  }

  // An empty picture, in pixels of the screen.
  begin(width, height) {
    if (!this.image || this.image.width !== width || this.image.height !== height) {
      this.canvas.width = width;
      this.canvas.height = height;
      this.image = new ImageData(width, height);
      this.pixels = new Int32Array(this.image.data.buffer);
    } else {
      this.pixels.fill(0);
    }
  }

  // Discs of one style from now on: `paint` fills and strokes the path of a context.
  style(name, paint) {
    this.paint = paint;
    if (!this.stamps.has(name)) this.stamps.set(name, new Map());
    this.current = this.stamps.get(name);
  }

  add(x, y, radius) {
    const left = Math.floor(x), top = Math.floor(y);
    if (!(Math.abs(left) < 1e6 && Math.abs(top) < 1e6)) return;
    const column = Math.floor(PARTS * (x - left)), row = Math.floor(PARTS * (y - top)), size = Math.round(PARTS * radius);
    const key = (size * PARTS + column) * PARTS + row;
    let stamp = this.current.get(key);
    if (!stamp) {
      if (this.current.size >= MOST_STAMPS) this.current.clear();
      stamp = this.makeStamp(size / PARTS, (column + 0.5) / PARTS, (row + 0.5) / PARTS);
      this.current.set(key, stamp);
    }
    this.press(stamp, left - stamp.middle, top - stamp.middle);
  }

  makeStamp(radius, dx, dy) {
    const middle = Math.ceil(radius) + 2, size = 2 * middle + 1;
    const canvas = document.createElement('canvas');
    canvas.width = canvas.height = size;
    const context = canvas.getContext('2d', {willReadFrequently: true});
    context.beginPath();
    context.arc(middle + dx, middle + dy, radius, 0, 2 * Math.PI);
    this.paint(context, radius);
    const {data} = context.getImageData(0, 0, size, size);
    return {middle, size, pixels: new Int32Array(data.buffer)};
  }

  press({size, pixels}, x, y) {
    const {width, height} = this.image, out = this.pixels;
    const right = Math.min(size, width - x), bottom = Math.min(size, height - y), left = Math.max(0, -x);
    for (let row = Math.max(0, -y); row < bottom; ++row) {
      let from = row * size + left, to = (y + row) * width + x + left;
      for (const end = row * size + right; from < end; ++from, ++to) {
        const upper = pixels[from], lower = out[to];
        if (upper !== 0) out[to] = lower === 0 ? upper : blend(upper, lower);
      }
    }
  }

  // The part of the picture that the box covers.
  drawOn(context, x, y, width, height) {
    this.context.putImageData(this.image, 0, 0, x, y, width, height);
    context.save();
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.drawImage(this.canvas, x, y, width, height, x, y, width, height);
    context.restore();
  }
}
