// The plan that a building was found in: its picture, in the page's colours, and which floor is a room's.

const MOST_PIXELS = 2e7, FREE_GREY = 230, WALL_GREY = 100; // lighter is floor, darker is wall, between them the unknown

function sheet(width, height) {
  const canvas = document.createElement("canvas");
  [canvas.width, canvas.height] = [width, height];
  return canvas.getContext("2d");
}

class Floor {
  static async load(plan) {
    const where = "building, plan";
    need(typeof plan.href === "string" && plan.href.startsWith("data:image/png;base64,"), `${where}: expected a picture (PNG)`);
    need(Array.isArray(plan.corners) && plan.corners.length === 3, `${where}: expected three corners`);
    lines([plan.corners], where);
    const image = new Image();
    image.src = plan.href;
    try { await image.decode(); } catch { throw new Unreadable(`${where}: damaged picture`); }
    need(image.width * image.height <= MOST_PIXELS, `${where}: more than ${MOST_PIXELS} pixels`);
    return new Floor(image, plan.corners);
  }

  /** `corners` are the lower left, lower right and upper left one (m). */
  constructor(image, [low, right, up]) {
    const { width, height } = image;
    this.corners = [low, right, up, [right[0] + up[0] - low[0], right[1] + up[1] - low[1]]];
    // from pixels, row 0 above, to metres
    this.matrix = new DOMMatrix([
      (right[0] - low[0]) / width, (right[1] - low[1]) / width, (low[0] - up[0]) / height, (low[1] - up[1]) / height, up[0], up[1],
    ]);
    this.inverse = this.matrix.inverse();
    this.pixel_m = Math.hypot(right[0] - low[0], right[1] - low[1]) / width;
    const pen = sheet(width, height);
    pen.drawImage(image, 0, 0);
    const grey = pen.getImageData(0, 0, width, height).data, floor = new ImageData(width, height), wall = new ImageData(width, height);
    this.open = new Uint8Array(width * height); // floor on this side of the doors
    for (let i = 0; i < width * height; i++) {
      floor.data[4 * i + 3] = (grey[4 * i] > FREE_GREY) * 255;
      this.open[i] = floor.data[4 * i + 3] && i % width ? 1 : 0; // not the first column, so that no row runs into the next
      wall.data[4 * i + 3] = (grey[4 * i] < WALL_GREY) * 255;
    }
    this.shapes = { floor, wall };
    this.width = width;
    this.taken = new Uint8Array(width * height);
    this.painted = new Map();
  }

  /** Draw the floor and the walls in these colours, on a context in world coordinates. */
  draw(pen, floor, wall) {
    pen.save();
    pen.transform(...["a", "b", "c", "d", "e", "f"].map((name) => this.matrix[name]));
    for (const [shape, colour] of [["floor", floor], ["wall", wall]]) pen.drawImage(this.tinted(shape, colour), 0, 0);
    pen.restore();
  }

  tinted(shape, colour) {
    const key = `${shape} ${colour}`;
    if (!this.painted.has(key)) {
      const image = this.shapes[shape], pen = sheet(image.width, image.height);
      pen.putImageData(image, 0, 0);
      pen.globalCompositeOperation = "source-in";
      pen.fillStyle = colour;
      pen.fillRect(0, 0, image.width, image.height);
      this.painted.set(key, pen.canvas);
    }
    return this.painted.get(key);
  }

  pixel([x, y]) {
    const at = this.inverse.transformPoint(new DOMPoint(x, y));
    return [Math.floor(at.x), Math.floor(at.y)];
  }

  /** Shut a door, into its frame: no room's floor goes on beyond it. The bar leads from its middle to one end (m). */
  shut([x, y], [dx, dy]) {
    const steps = Math.ceil(3 * Math.hypot(dx, dy) / this.pixel_m);
    for (let i = -steps; i <= steps; i++) {
      const [column, row] = this.pixel([x + 1.5 * dx * i / steps, y + 1.5 * dy * i / steps]);
      for (const [c, r] of [[0, 0], [1, 0], [0, 1]]) this.open[(row + r) * this.width + column + c] = 0;
    }
  }

  /** A room's floor as a path and its box (m): what is nearest to a place, a little more than its area at most. */
  room(place, area) {
    const { width, open, taken } = this, [column, row] = this.pixel(place), most = 1.05 * area / this.pixel_m ** 2;
    const reach = Math.ceil(1.5 / this.pixel_m); // its node may stand in a table
    let first = -1, nearest = Infinity;
    for (let r = -reach; r <= reach; r++) {
      for (let c = -reach; c <= reach; c++) {
        const i = (row + r) * width + column + c, away = r * r + c * c;
        if (column + c >= 0 && column + c < width && open[i] && !taken[i] && away < nearest) [first, nearest] = [i, away];
      }
    }
    if (first < 0) return null;
    const mine = [first];
    taken[first] = 1;
    for (let at = 0; at < mine.length && mine.length < most; at++) {
      for (const step of [1, -1, width, -width]) {
        const next = mine[at] + step;
        if (!open[next] || taken[next]) continue;
        taken[next] = 1;
        mine.push(next);
      }
    }
    return this.outlined(mine.sort((a, b) => a - b));
  }

  /** Pixels, in order, as a path of rows and the box around them (m). */
  outlined(pixels) {
    const rows = new Path2D(), path = new Path2D(), { width } = this;
    let [left, right] = [Infinity, -Infinity];
    for (let i = 0, from = 0; i < pixels.length; i++) {
      if (pixels[i + 1] === pixels[i] + 1) continue;
      const column = pixels[from] % width, size = i + 1 - from;
      rows.rect(column, Math.floor(pixels[from] / width), size, 1);
      [left, right] = [Math.min(left, column), Math.max(right, column + size)];
      from = i + 1;
    }
    path.addPath(rows, this.matrix);
    const [top, bottom] = [Math.floor(pixels[0] / width), Math.floor(pixels.at(-1) / width) + 1];
    const corners = [[left, top], [right, top], [left, bottom], [right, bottom]];
    return { path, box: boxOf(corners.map(([x, y]) => { const at = this.matrix.transformPoint(new DOMPoint(x, y)); return [at.x, at.y]; })) };
  }
}

/** Left, right, low and high of points. */
function boxOf(points) {
  const xs = points.map((p) => p[0]), ys = points.map((p) => p[1]);
  return [Math.min(...xs), Math.max(...xs), Math.min(...ys), Math.max(...ys)];
}
