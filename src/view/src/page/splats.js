// Splats in the browser: a thread projects and orders them, WebGL2 blends them from back to front. Where WebGL2 is a program that runs on
// the processor, or missing, the thread blends them.

const VERTEX = `#version 300 es
precision highp float;
uniform vec2 size;
uniform float border;
in vec2 place;
in vec4 shape;
in vec4 color;
flat out vec2 middle;
flat out vec4 footprint;
flat out vec4 light;
void main() {
  middle = vec2(place.x, size.y - place.y);
  footprint = shape;
  light = color;
  gl_PointSize = shape.w;
  gl_Position = vec4(vec2(2.0, -2.0) * (place / size - 0.5) / border, 0.0, 1.0);
}`;

const FRAGMENT = `#version 300 es
precision highp float;
flat in vec2 middle;
flat in vec4 footprint;
flat in vec4 light;
out vec4 share;
void main() {
  // Points are drawn at places that are rounded, by a sixteenth of a pixel or so, and so is gl_PointCoord.
  vec2 d = gl_FragCoord.xy - middle;
  float alpha = min(0.99, light.a * exp(-0.5 * (footprint.x * d.x * d.x + footprint.z * d.y * d.y) + footprint.y * d.x * d.y));
  if (alpha < 1.0 / 255.0) discard;
  share = vec4(light.rgb * alpha, alpha);
}`;

/** Bytes of a point as the projector makes it. */
const STRIDE = 28;
/** Points whose middle is outside of the viewport are dropped, so it is this many times as wide as the picture. */
const BORDER = 2;

/** Share of the width, and of the splats, at which a moving camera shows them: one in so many. */
const LEVELS = [[1, 1], [2, 1], [2, 4], [3, 9], [4, 16]];
/** Where a moving camera begins without a GPU: the processor has a picture of 100,000 splats in 50 ms. */
const SOFTWARE_LEVEL = 2;
/** A moving camera goes to the next level if a picture takes longer, and back if it takes so much less that a finer one is as fast. */
const [SLOW_MS, FAST_MS] = [60, 12];
/** Twice the exponent to which a moving camera draws a splat: 2.5 standard deviations. One at rest draws what is above 1 / 255. */
const MOVING_MOST = 6.25;

/** Draws splats onto a canvas. */
export class Splats {
  /** `drawn` is called with each view that is drawn. Throws if WebGL2 refuses the shaders. */
  constructor(canvas, drawn, { isSoftware = !hasGpu(), projector = new URL("projector.js", import.meta.url) } = {}) {
    Object.assign(this, { canvas, drawn, loaded: false, wanted: null, busy: false, level: isSoftware ? SOFTWARE_LEVEL : 0 });
    if (isSoftware) this.flat = canvas.getContext("2d", { alpha: false });
    else this.begin(canvas.getContext("webgl2", { alpha: false, depth: false, antialias: false }));
    this.projector = new Worker(projector);
    this.projector.addEventListener("message", ({ data }) => this.draw(data));
  }
  begin(gl) {
    this.gl = gl;
    const program = linked(gl);
    gl.useProgram(program);
    this.size = gl.getUniformLocation(program, "size");
    gl.uniform1f(gl.getUniformLocation(program, "border"), BORDER);
    gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
    for (const [name, parts, type, offset] of [["place", 2, gl.FLOAT, 0], ["shape", 4, gl.FLOAT, 8], ["color", 4, gl.UNSIGNED_BYTE, 24]]) {
      const at = gl.getAttribLocation(program, name);
      gl.enableVertexAttribArray(at);
      gl.vertexAttribPointer(at, parts, type, type === gl.UNSIGNED_BYTE, STRIDE, offset);
    }
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
  }
  /** Takes splats as the server packs them, in place of those before. */
  load(buffer) {
    this.loaded = true;
    this.projector.postMessage({ buffer }, [buffer]);
  }
  /** Draws a view as soon as the one before is drawn. Of the views in between only the newest is drawn. At rest nothing is left out. */
  show(view, isMoving = false) {
    this.wanted = { ...view, isMoving };
    this.next();
  }
  next() {
    if (this.busy || !this.wanted || !this.loaded) return;
    this.busy = true;
    const { wanted } = this;
    this.wanted = null;
    const [divisor, stride] = LEVELS[wanted.isMoving ? this.level : 0];
    const view = { ...wanted, camera: reduced(wanted.camera, divisor), stride, most: wanted.isMoving ? MOVING_MOST : Infinity };
    this.sent = performance.now();
    this.projector.postMessage({ view, isDrawn: !this.gl });
  }
  draw(made) {
    const { canvas, level } = this;
    const { view } = made;
    const { width, height } = view.camera;
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    if (this.gl) this.blend(made);
    else this.flat.putImageData(new ImageData(made.pixels, width, height), 0, 0);
    const took = performance.now() - this.sent;
    if (view.isMoving && took > SLOW_MS) this.level = Math.min(level + 1, LEVELS.length - 1);
    if (view.isMoving && took < FAST_MS) this.level = Math.max(level - 1, 0);
    this.busy = false;
    this.next();
    this.drawn(view);
  }
  blend({ points, count, view }) {
    const { gl } = this;
    const { width, height } = view.camera;
    const beyond = (BORDER - 1) / 2;
    gl.viewport(...[-beyond * width, -beyond * height, BORDER * width, BORDER * height].map(Math.round));
    gl.clearColor(0, 0, 0, 1);
    gl.clear(gl.COLOR_BUFFER_BIT);
    gl.uniform2f(this.size, width, height);
    gl.bufferData(gl.ARRAY_BUFFER, points, gl.STREAM_DRAW);
    gl.drawArrays(gl.POINTS, 0, count);
  }
}

/** Returns whether WebGL2 runs on a GPU. */
function hasGpu() {
  const gl = document.createElement("canvas").getContext("webgl2");
  if (!gl) return false;
  const names = gl.getExtension("WEBGL_debug_renderer_info");
  const name = gl.getParameter(names ? names.UNMASKED_RENDERER_WEBGL : gl.RENDERER);
  gl.getExtension("WEBGL_lose_context")?.loseContext();
  return !/swiftshader|llvmpipe|softpipe|software|basic render/i.test(name);
}

/** Returns a camera with a share of the pixels in each direction. */
function reduced(camera, divisor) {
  const lengths = ["fx_px", "fy_px", "cx_px", "cy_px"].map((key) => [key, camera[key] / divisor]);
  const [width, height] = [camera.width, camera.height].map((side) => Math.ceil(side / divisor));
  return { ...camera, ...Object.fromEntries(lengths), width, height };
}

function linked(gl) {
  const program = gl.createProgram();
  for (const [kind, source] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    gl.attachShader(program, shader);
  }
  gl.linkProgram(program);
  if (gl.getProgramParameter(program, gl.LINK_STATUS)) return program;
  const logs = gl.getAttachedShaders(program).map((shader) => gl.getShaderInfoLog(shader));
  throw new Error(`WebGL2 refuses the shaders: ${logs.join(" ")}`);
}
