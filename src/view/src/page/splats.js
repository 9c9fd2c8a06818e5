// Splats in the browser: a thread projects and orders them, WebGL2 blends them from back to front.

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

/** Draws splats onto a canvas. */
export class Splats {
  /** `drawn` is called with each view that is drawn. Throws if the browser has no WebGL2. */
  constructor(canvas, drawn) {
    const gl = canvas.getContext("webgl2", { alpha: false, depth: false, antialias: false });
    if (!gl) throw new Error("This browser has no WebGL2.");
    Object.assign(this, { canvas, gl, drawn, loaded: false, wanted: null, busy: false });
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
    this.projector = new Worker(new URL("projector.js", import.meta.url));
    this.projector.addEventListener("message", ({ data }) => this.draw(data));
  }
  /** Takes splats as the server packs them, in place of those before. */
  load(buffer) {
    this.loaded = true;
    this.projector.postMessage({ buffer }, [buffer]);
  }
  /** Draws a view as soon as the one before is drawn. Of the views in between only the newest is drawn. */
  show(view) {
    this.wanted = view;
    this.next();
  }
  next() {
    if (this.busy || !this.wanted || !this.loaded) return;
    this.busy = true;
    this.projector.postMessage({ view: this.wanted });
    this.wanted = null;
  }
  draw({ points, count, view }) {
    const { gl, canvas } = this;
    const { width, height } = view.camera;
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    const beyond = (BORDER - 1) / 2;
    gl.viewport(...[-beyond * width, -beyond * height, BORDER * width, BORDER * height].map(Math.round));
    gl.clearColor(0, 0, 0, 1);
    gl.clear(gl.COLOR_BUFFER_BIT);
    gl.uniform2f(this.size, width, height);
    gl.bufferData(gl.ARRAY_BUFFER, points, gl.STREAM_DRAW);
    gl.drawArrays(gl.POINTS, 0, count);
    this.busy = false;
    this.next();
    this.drawn(view, count);
  }
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
