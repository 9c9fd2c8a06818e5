// Projects splats onto the picture of a camera and orders them, the farthest first, in a thread of its own.
//
// A splat is a disc of standard deviation σ, a tenth as thick: Σ = σ² (I - n nᵀ) + (σ / 10)² n nᵀ. As in our rasteriser
// (stages/surface/src/splats/raster.rs) its footprint is Σ' = J W Σ Wᵀ Jᵀ + 0.3 I: Zwicker et al., EWA Splatting, TVCG 2002, and Kerbl et
// al., 3D Gaussian Splatting, SIGGRAPH 2023, for 0.3. The browser's GPU could project too, but one that is a program takes ten times as long.

const [THIN, LOW_PASS, OUTSIDE, NEAR] = [0.1, 0.3, 1.3, 3];
/** 32-bit numbers of a point: place, inverse of Σ', width, colour. */
const NUMBERS = 7;

let splats = { count: 0 };
const bits = new Uint32Array(1);
const float = new Float32Array(bits.buffer);

/** Reads splats as the server packs them (src/view/src/splats.rs). */
function read(buffer) {
  const count = buffer.byteLength / 24;
  const places = new Float32Array(buffer, 0, 4 * count);
  const folded = new Int16Array(buffer, 16 * count);
  const colors = new Uint32Array(buffer, 16 * count);
  const normals = new Float32Array(3 * count);
  for (let index = 0; index < count; index += 1) {
    let x = folded[4 * index] / 32767, y = folded[4 * index + 1] / 32767;
    const z = 1 - Math.abs(x) - Math.abs(y);
    if (z < 0) [x, y] = [(1 - Math.abs(y)) * (x < 0 ? -1 : 1), (1 - Math.abs(x)) * (y < 0 ? -1 : 1)];
    normals.set([x, y, z].map((part) => part / Math.hypot(x, y, z)), 3 * index);
  }
  splats = { count, places, colors, normals, keys: new Uint32Array(count), seen: new Uint32Array(count), sorted: new Uint32Array(count) };
}

/** Orders what the camera sees by depth, into `sorted`. Returns how many. */
function order({ camera, pose: [right, down, forward] }) {
  const { count, places, keys, seen, sorted } = splats;
  const [rx, ry, rz, rt] = right, [dx, dy, dz, dt] = down, [fx, fy, fz, ft] = forward;
  // Half the picture at depth 1, and as much more as a lens bends.
  const slope = (size, middle, focal) => (OUTSIDE * Math.max(middle, size - middle)) / focal;
  const across = slope(camera.width, camera.cx_px, camera.fx_px), along = slope(camera.height, camera.cy_px, camera.fy_px);
  let length = 0, least = 0xffffffff, most = 0;
  for (let index = 0, at = 0; index < count; index += 1, at += 4) {
    const x = places[at], y = places[at + 1], z = places[at + 2], sigma = places[at + 3];
    const depth = fx * x + fy * y + fz * z + ft;
    if (depth <= NEAR * sigma) continue;
    if (Math.abs(rx * x + ry * y + rz * z + rt) > depth * across + 4 * sigma) continue;
    if (Math.abs(dx * x + dy * y + dz * z + dt) > depth * along + 4 * sigma) continue;
    // The bits of positive floats are in the order of the floats, and nearly logarithmic.
    float[0] = depth;
    const key = bits[0];
    keys[length] = key;
    seen[length] = index;
    length += 1;
    if (key < least) least = key;
    if (key > most) most = key;
  }
  const shift = Math.max(0, 16 - Math.clz32(Math.max(0, most - least)));
  const starts = new Uint32Array(65537);
  for (let place = 0; place < length; place += 1) {
    keys[place] = 65535 - ((keys[place] - least) >>> shift);
    starts[keys[place] + 1] += 1;
  }
  for (let key = 0; key < 65536; key += 1) starts[key + 1] += starts[key];
  for (let place = 0; place < length; place += 1) sorted[starts[keys[place]]++] = seen[place];
  return length;
}

/** Projects what a camera sees. Returns the points from back to front, and how many. */
function project(view) {
  const ordered = order(view);
  const { places, normals, colors, sorted } = splats;
  const { width, height, fx_px, fy_px, cx_px, cy_px, k1, k2, p1, p2 } = view.camera;
  const [[rx, ry, rz, rt], [dx, dy, dz, dt], [fx, fy, fz, ft]] = view.pose;
  const points = new Float32Array(NUMBERS * ordered);
  const words = new Uint32Array(points.buffer);
  const mostX = (OUTSIDE * width) / fx_px, mostY = (OUTSIDE * height) / fy_px;
  let at = 0;
  for (let place = 0; place < ordered; place += 1) {
    const index = sorted[place];
    const x = places[4 * index], y = places[4 * index + 1], z = places[4 * index + 2], sigma = places[4 * index + 3];
    const nx = normals[3 * index], ny = normals[3 * index + 1], nz = normals[3 * index + 2];
    const depth = fx * x + fy * y + fz * z + ft;
    const u = (rx * x + ry * y + rz * z + rt) / depth, v = (dx * x + dy * y + dz * z + dt) / depth;
    const r2 = u * u + v * v;
    // Beyond this radius the distortion has no inverse.
    if (1 + r2 * (3 * k1 + 5 * k2 * r2) <= 0) continue;
    const radial = 1 + r2 * (k1 + k2 * r2);
    const column = fx_px * (u * radial + 2 * p1 * u * v + p2 * (r2 + 2 * u * u)) + cx_px;
    const row = fy_px * (v * radial + p1 * (r2 + 2 * v * v) + 2 * p2 * u * v) + cy_px;
    // Rows of J: (ax, 0, az) and (0, by, bz).
    const ax = fx_px / depth, by = fy_px / depth;
    const az = -ax * Math.min(mostX, Math.max(-mostX, u)), bz = -by * Math.min(mostY, Math.max(-mostY, v));
    const forward = fx * nx + fy * ny + fz * nz;
    const a = ax * (rx * nx + ry * ny + rz * nz) + az * forward, b = by * (dx * nx + dy * ny + dz * nz) + bz * forward;
    const wide = sigma * sigma, less = wide * (1 - THIN * THIN);
    const xx = (ax * ax + az * az) * wide - a * a * less + LOW_PASS;
    const xy = az * bz * wide - a * b * less;
    const yy = (by * by + bz * bz) * wide - b * b * less + LOW_PASS;
    // To where its share is 1 / 255, along its longest axis.
    const longest = 0.5 * (xx + yy) + Math.sqrt(0.25 * (xx - yy) * (xx - yy) + xy * xy);
    const color = colors[2 * index + 1];
    const reach = Math.sqrt(2 * Math.log(Math.max(1, color >>> 24)) * longest);
    if (Math.abs(column - 0.5 * width) > 0.5 * width + reach || Math.abs(row - 0.5 * height) > 0.5 * height + reach) continue;
    const determinant = xx * yy - xy * xy;
    points[at] = column;
    points[at + 1] = row;
    points[at + 2] = yy / determinant;
    points[at + 3] = -xy / determinant;
    points[at + 4] = xx / determinant;
    points[at + 5] = 2 * reach + 1;
    words[at + 6] = color;
    at += NUMBERS;
  }
  return { points, count: at / NUMBERS };
}

onmessage = ({ data }) => {
  if (data.buffer) return read(data.buffer);
  const { points, count } = project(data.view);
  postMessage({ points, count, view: data.view }, [points.buffer]);
};
