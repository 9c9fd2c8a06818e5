// Vectors, poses, and the camera that the user moves.
//
// Frames of reference: the world of the scene; a camera has x right, y down, z forward; x_cam = R x_world + t. A pose is
// `cam_from_world`, the rows of [R | t].

export const add = (a, b, factor = 1) => [0, 1, 2].map((i) => a[i] + factor * b[i]);
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
export const cross = (a, b) => [0, 1, 2].map((i) => a[(i + 1) % 3] * b[(i + 2) % 3] - a[(i + 2) % 3] * b[(i + 1) % 3]);
export const norm = (a) => Math.hypot(...a);
const unit = (a) => a.map((value) => value / (norm(a) || 1));
export const clamp = (value, low, high) => Math.min(high, Math.max(low, value));

/** Returns a point of the world in the camera, R x + t. */
export const transformed = (pose, point) => pose.map((row) => dot(row, point) + row[3]);
/** Returns the centre of a camera in the world, -Rᵀ t. */
export const centreOf = (pose) => [0, 1, 2].map((i) => -(pose[0][i] * pose[0][3] + pose[1][i] * pose[1][3] + pose[2][i] * pose[2][3]));
/** Returns a point of the camera in the world, Rᵀ x + centre. */
export const inWorld = (pose, point) =>
  add(centreOf(pose), [0, 1, 2].map((i) => pose[0][i] * point[0] + pose[1][i] * point[1] + pose[2][i] * point[2]));

/** A camera that looks from `eye` along yaw and pitch (radians, about up), and turns around the point at `distance`. */
export class Mover {
  constructor(up, eye, forward, distance) {
    this.up = unit(up);
    const aside = Math.abs(this.up[0]) < 0.9 ? [1, 0, 0] : [0, 1, 0];
    this.north = unit(add(aside, this.up, -dot(aside, this.up)));
    this.east = cross(this.north, this.up);
    this.look(eye, forward, distance);
  }
  look(eye, forward, distance) {
    const towards = unit(forward);
    this.eye = eye;
    this.distance = distance;
    this.pitch = Math.asin(clamp(dot(towards, this.up), -1, 1));
    this.yaw = Math.atan2(dot(towards, this.east), dot(towards, this.north));
  }
  forward() {
    const flat = add(this.north.map((value) => value * Math.cos(this.yaw)), this.east, Math.sin(this.yaw));
    return add(flat.map((value) => value * Math.cos(this.pitch)), this.up, Math.sin(this.pitch));
  }
  right() { return unit(cross(this.forward(), this.up)); }
  pose() {
    const [right, forward] = [this.right(), this.forward()];
    return [right, cross(forward, right), forward].map((row) => [...row, -dot(row, this.eye)]);
  }
  turn(yaw, pitch) {
    this.yaw += yaw;
    this.pitch = clamp(this.pitch + pitch, -1.55, 1.55);
  }
  orbit(yaw, pitch) {
    const target = add(this.eye, this.forward(), this.distance);
    this.turn(yaw, pitch);
    this.eye = add(target, this.forward(), -this.distance);
  }
  /** Moves right, down and forward, world units. */
  move([right, down, forward]) {
    const downwards = cross(this.forward(), this.right());
    this.eye = add(add(add(this.eye, this.right(), right), downwards, down), this.forward(), forward);
  }
  zoom(factor) {
    const target = add(this.eye, this.forward(), this.distance);
    this.distance *= factor;
    this.eye = add(target, this.forward(), -this.distance);
  }
}

/** What a key does in some seconds, in which the camera flies some world units. */
export const KEYS = {
  KeyW: (mover, _, way) => mover.move([0, 0, way]),
  KeyS: (mover, _, way) => mover.move([0, 0, -way]),
  KeyA: (mover, _, way) => mover.move([-way, 0, 0]),
  KeyD: (mover, _, way) => mover.move([way, 0, 0]),
  KeyQ: (mover, _, way) => mover.move([0, way, 0]),
  KeyE: (mover, _, way) => mover.move([0, -way, 0]),
  ArrowLeft: (mover, seconds) => mover.turn(-seconds, 0),
  ArrowRight: (mover, seconds) => mover.turn(seconds, 0),
  ArrowUp: (mover, seconds) => mover.turn(0, seconds),
  ArrowDown: (mover, seconds) => mover.turn(0, -seconds),
  Equal: (mover, seconds) => mover.zoom(1 - seconds),
  NumpadAdd: (mover, seconds) => mover.zoom(1 - seconds),
  Minus: (mover, seconds) => mover.zoom(1 + seconds),
  NumpadSubtract: (mover, seconds) => mover.zoom(1 + seconds),
};
