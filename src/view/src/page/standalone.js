// The 3-D view of a page without a server: splats of the field, from data in the page.

import { KEYS, Mover, add, centreOf, norm } from "./mover.js";
import { Splats } from "./splats.js";

const element = (id) => document.getElementById(id);
/** The camera rests when nobody has moved it for so long. */
const STILL_MS = 150;
/** Widest picture. */
const WIDEST_PX = 960;

class StandaloneView {
  constructor(canvas) {
    Object.assign(this, { canvas, keys: new Set(), pointers: new Map() });
    this.scene = JSON.parse(element("view-scene").textContent);
    const code = new Blob([element("view-projector").textContent], { type: "text/javascript" });
    this.splats = new Splats(canvas, () => { canvas.dataset.frames = Number(canvas.dataset.frames ?? 0) + 1; }, { projector: URL.createObjectURL(code) });
    this.splats.load(Uint8Array.from(atob(element("view-data").textContent), (letter) => letter.charCodeAt(0)).buffer);
    this.listen();
    this.toStart();
  }
  toStart() {
    const { start, up, focus } = this.scene;
    this.mover = new Mover(up, centreOf(start), start[2].slice(0, 3), norm(add(focus, centreOf(start), -1)));
    this.draw(false);
  }
  draw(isMoving) {
    const { camera } = this.scene;
    const width = Math.min(WIDEST_PX, Math.round(this.canvas.clientWidth * devicePixelRatio)) || 320;
    const factor = width / camera.width;
    const lengths = ["fx_px", "fy_px", "cx_px", "cy_px"].map((key) => [key, factor * camera[key]]);
    const sized = { ...camera, ...Object.fromEntries(lengths), width, height: Math.round(factor * camera.height) };
    this.splats.show({ camera: sized, pose: this.mover.pose() }, isMoving);
  }
  moved() {
    this.draw(true);
    clearTimeout(this.rest);
    this.rest = setTimeout(() => this.draw(false), STILL_MS);
  }
  listen() {
    const { canvas, pointers, keys } = this;
    addEventListener("resize", () => this.draw(false));
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      pointers.set(event.pointerId, [event.clientX, event.clientY]);
    });
    canvas.addEventListener("pointermove", (event) => this.drag(event));
    for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, (event) => pointers.delete(event.pointerId));
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.mover.zoom(Math.exp(event.deltaY * 0.001));
      this.moved();
    }, { passive: false });
    canvas.addEventListener("keydown", (event) => this.key(event));
    canvas.addEventListener("keyup", (event) => keys.delete(event.code));
    canvas.addEventListener("blur", () => keys.clear());
  }
  drag(event) {
    const last = this.pointers.get(event.pointerId);
    if (!last) return;
    const now = [event.clientX, event.clientY];
    const [dx, dy] = [now[0] - last[0], now[1] - last[1]];
    const other = [...this.pointers].find(([id]) => id !== event.pointerId)?.[1];
    this.pointers.set(event.pointerId, now);
    const across = this.mover.distance / this.canvas.clientWidth;
    if (other) {
      const apart = (place) => Math.hypot(place[0] - other[0], place[1] - other[1]) || 1;
      this.mover.zoom(apart(last) / apart(now));
      this.mover.move([(-dx * across) / 2, (-dy * across) / 2, 0]);
    } else if (event.shiftKey || event.buttons & 6) this.mover.move([-dx * across, -dy * across, 0]);
    else this.mover.orbit(dx * 0.006, -dy * 0.006);
    this.moved();
  }
  key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.key === "0") return this.toStart();
    if (!(event.code in KEYS)) return;
    event.preventDefault();
    const first = this.keys.size === 0;
    this.keys.add(event.code);
    if (first) { this.before = performance.now() - 16; this.fly(this.before + 16); }
  }
  /** Moves as long as keys are held: half the distance to what is looked at in a second. */
  fly(now) {
    if (this.keys.size === 0) return;
    const seconds = Math.min(0.1, Math.max(0, now - this.before) / 1000);
    this.before = now;
    for (const code of this.keys) KEYS[code](this.mover, seconds, 0.5 * this.mover.distance * seconds);
    this.moved();
    requestAnimationFrame((time) => this.fly(time));
  }
}

new StandaloneView(element("view-canvas"));
