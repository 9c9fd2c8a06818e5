// The 3-D view of a trained field. Poses are `cam_from_world`; text from outside goes through textContent.

import { KEYS, Mover, add, centreOf, clamp, inWorld, norm, transformed } from "./mover.js";
import { Pictures, post, refused } from "./pictures.js";
import { Splats } from "./splats.js";

const byId = (id) => document.getElementById(id);

// ---- the 3-D view

/** The camera rests when nobody has moved it for so long. */
const REST_MS = 150;

class View {
  constructor(run) {
    this.run = run;
    this.picture = byId("view-picture");
    this.overlay = byId("view-overlay");
    this.pictures = new Pictures((view, picture) => this.show(view, picture), (why) => this.say(why));
    try {
      this.splats = new Splats(byId("view-splats"), (view) => this.splatted(view));
    } catch (error) {
      this.saySplats(`${error.message} Pictures come from marf alone.`);
    }
    this.keys = new Set();
    this.pointers = new Map();
    this.marks = [];
    this.bookmarks = [];
    byId("view-size").value = matchMedia("(max-width: 700px)").matches ? "320" : "640";
    this.listen();
  }
  say(text) { byId("view-state").textContent = text; }
  saySplats(text) { byId("view-splats-state").textContent = text; }
  get mode() { return byId("view-mode").value; }

  async open() {
    const response = await fetch(`scene/${this.run}/${byId("view-field").value}`);
    const why = await refused(response);
    if (why) return this.say(why);
    this.scene = await response.json();
    this.scale = this.scene.metres_per_unit ?? 1;
    byId("view-mode").querySelector("[value=uncertainty]").disabled = this.scene.members < 2;
    const photos = byId("view-photo");
    photos.replaceChildren(new Option("", ""), ...this.scene.photos.map((photo, index) => new Option(photo.file, index)));
    Object.assign(this, { hasSplats: false, making: false, shown: null });
    this.saySplats("");
    this.toStart();
    this.showPoints();
  }
  /** Returns the address of something of the field. */
  address(kind) { return `${kind}/${this.run}/${byId("view-field").value}`; }
  toStart() {
    const { start, up, focus } = this.scene;
    const eye = centreOf(start);
    this.mover = new Mover(up, eye, start[2].slice(0, 3), norm(add(focus, eye, -1)));
    this.leavePhoto();
    this.draw();
  }
  leavePhoto() {
    this.fixed = null;
    byId("view-photo").value = "";
    byId("view-compare").hidden = true;
    // A difference is from a photo: from elsewhere there is none.
    if (this.mode === "difference") byId("view-mode").value = "color";
  }
  /** Returns camera and pose to be shown: those of a photo, or those that the user has moved to. */
  place() {
    const width = Number(byId("view-size").value);
    const { camera, cam_from_world } = this.fixed ?? { camera: this.scene.camera, cam_from_world: this.mover.pose() };
    const height = Math.max(1, Math.round((width * camera.height) / camera.width));
    const [sx, sy] = [width / camera.width, height / camera.height];
    const sized = { width, height, fx_px: camera.fx_px * sx, cx_px: camera.cx_px * sx, fy_px: camera.fy_px * sy, cy_px: camera.cy_px * sy };
    return { camera: { ...camera, ...sized }, cam_from_world };
  }
  draw() {
    if (!this.scene) return;
    clearTimeout(this.rest);
    const view = this.view();
    this.drawSplats(view, false);
    this.pictures.want(view);
    this.legend();
  }
  /** Returns the request for the picture to be shown. */
  view() {
    const photo = this.mode === "difference" ? { photo: this.fixed.image } : {};
    const request = { run: this.run, field: Number(byId("view-field").value), mode: this.mode, ...photo, ...this.place() };
    return { ...request, since: performance.now() };
  }

  // ---- splats

  /** Draws splats, or points until there are some; the field's picture is drawn over them. */
  drawSplats(view, isMoving) {
    this.resize(view.camera);
    if (view.mode !== "color") return byId("view-stage").classList.remove("moving");
    this.splats?.show({ camera: view.camera, pose: view.cam_from_world, view }, isMoving);
  }
  /** Shows splats or points that are drawn, unless the field's picture of the same view is there. */
  splatted({ view }) {
    if (view.since === this.pictured || this.mode !== "color") return;
    if (this.hasSplats) {
      const { dataset, classList } = byId("view-stage");
      const took = performance.now() - view.since;
      dataset.frames = Number(dataset.frames ?? 0) + 1;
      dataset.firstMs ??= Math.round(took);
      classList.add("moving");
    } else if (this.shown) return;
    this.shown = view;
    this.drawOverlay();
  }
  async showPoints() {
    const { scene } = this;
    const response = await fetch(this.address("points"));
    const why = await refused(response);
    if (why) return this.saySplats(why);
    this.loadSplats(scene, await response.arrayBuffer());
  }
  loadSplats(scene, buffer) {
    if (scene !== this.scene || !this.splats) return;
    this.splats.load(buffer);
    if (!this.shown) this.drawSplats(this.view(), false);
  }
  /** Asks for splats until they are made: once the camera is moved, since making them takes a while. */
  async makeSplats() {
    if (this.making || !this.splats) return;
    this.making = true;
    const { scene } = this;
    while (scene === this.scene) {
      const response = await fetch(this.address("splats"));
      const why = await refused(response);
      if (why) return this.saySplats(`The view has no splats: ${why}`);
      if (response.status !== 202) {
        const buffer = await response.arrayBuffer();
        if (scene !== this.scene) return;
        this.hasSplats = true;
        byId("view-stage").dataset.splats = buffer.byteLength / 24;
        this.saySplats(`${(buffer.byteLength / 24).toLocaleString("en")} splats are drawn while the camera moves.`);
        return this.loadSplats(scene, buffer);
      }
      const { done, total, note } = await response.json();
      this.saySplats(`marf makes splats, with which the view moves smoothly${total ? `: ${note}, ${done} of ${total}` : ""}.`);
      await new Promise((resolve) => setTimeout(resolve, 500));
    }
  }
  legend() {
    byId("view-legend").hidden = this.mode === "color";
    if (this.mode === "color") return;
    const [low, high] = this.scene.scales[this.mode].map((end) => Number((end * (this.mode === "depth" ? this.scale : 1)).toPrecision(3)));
    const unitOf = {
      depth: this.scene.metres_per_unit ? "m, logarithmic" : "units of the scene (no scale), logarithmic",
      uncertainty: "standard deviation of gray, white = 1",
      difference: "of gray from the photo, white = 1",
    };
    byId("view-low").textContent = low;
    byId("view-high").textContent = `${high} ${unitOf[this.mode]}`;
    byId("view-scale").className = `scale ${this.mode}`;
  }
  resize({ width, height }) {
    if (this.picture.width !== width || this.picture.height !== height) {
      for (const canvas of [this.picture, this.overlay]) Object.assign(canvas, { width, height });
      // A picture of upright photos stays within the window.
      byId("view-stage").style.maxWidth = `${Math.round((720 * width) / height)}px`;
    }
  }
  show(view, { bitmap, divisor }) {
    const { width, height } = view.camera;
    this.resize(view.camera);
    // Coarse pictures show less than splats.
    if (divisor <= 2 || !this.hasSplats || view.mode !== "color") {
      this.picture.getContext("2d").drawImage(bitmap, 0, 0, width, height);
      this.pictured = view.since;
      byId("view-stage").classList.remove("moving");
    }
    this.shown = view;
    const after = Math.round(performance.now() - view.since);
    const data = byId("view-stage").dataset;
    if (divisor === 8) data.firstMs ??= after;
    Object.assign(data, { divisor, pictures: Number(data.pictures ?? 0) + 1 });
    this.say(`${bitmap.width} x ${bitmap.height} pixels after ${after} ms${divisor > 1 ? ", going on" : ""}.`);
    if (this.fixed) this.compare(bitmap);
    this.drawOverlay();
  }

  // ---- photos

  /** Shows what is chosen; a difference from the photo whose pose is nearest. */
  showMode() {
    if (this.scene && this.mode === "difference" && !this.fixed) return this.toPhoto(this.nearestPhoto());
    this.draw();
  }
  /** Returns the number of the photo that is nearest in position, and in direction by as much as the distance of what is looked at. */
  nearestPhoto() {
    const [eye, forward] = [this.mover.eye, this.mover.forward()];
    const away = ({ cam_from_world }) =>
      Math.hypot(norm(add(centreOf(cam_from_world), eye, -1)), this.mover.distance * norm(add(cam_from_world[2].slice(0, 3), forward, -1)));
    const all = this.scene.photos.map(away);
    return all.indexOf(Math.min(...all));
  }
  toPhoto(index) {
    const photo = this.scene.photos[index];
    this.fixed = photo;
    const forward = photo.cam_from_world[2].slice(0, 3);
    this.mover.look(centreOf(photo.cam_from_world), forward, this.mover.distance);
    byId("view-photo").value = String(index);
    const picture = byId("view-photo-picture");
    picture.src = `photo/${this.run}/${byId("view-field").value}/${photo.image}`;
    picture.alt = `photo ${photo.file}`;
    byId("view-photo-name").textContent = `${photo.file}${photo.held_out ? ", held out" : ""}`;
    byId("view-compare").hidden = false;
    this.draw();
  }
  compare(bitmap) {
    const render = byId("view-photo-render");
    const { width, height } = this.shown.camera;
    Object.assign(render, { width, height });
    render.getContext("2d").drawImage(bitmap, 0, 0, width, height);
  }
  /** Returns the pixel of a point of the world in the shown picture, distortion aside; null behind the camera. */
  pixel(point) {
    const { camera, cam_from_world } = this.shown;
    const [x, y, z] = transformed(cam_from_world, point);
    return z > 1e-3 * this.mover.distance ? [camera.fx_px * (x / z) + camera.cx_px, camera.fy_px * (y / z) + camera.cy_px] : null;
  }
  frustum({ camera, cam_from_world }) {
    const depth = 0.04 * norm(add(this.scene.focus, centreOf(this.scene.start), -1));
    const corner = ([x, y]) => inWorld(cam_from_world, [(x - camera.cx_px) / camera.fx_px, (y - camera.cy_px) / camera.fy_px, 1].map((value) => value * depth));
    const { width, height } = camera;
    return [centreOf(cam_from_world), ...[[0, 0], [width, 0], [width, height], [0, height]].map(corner)].map((point) => this.pixel(point));
  }
  drawOverlay() {
    const canvas = this.overlay.getContext("2d");
    canvas.clearRect(0, 0, this.overlay.width, this.overlay.height);
    if (byId("view-frusta").checked) this.scene.photos.forEach((photo) => photo !== this.fixed && this.drawFrustum(canvas, photo));
    canvas.fillStyle = canvas.strokeStyle = "#fff35c";
    const pixels = this.marks.map((mark) => this.pixel(mark.point)).filter(Boolean);
    pixels.forEach(([x, y]) => { canvas.beginPath(); canvas.arc(x, y, 5, 0, 7); canvas.fill(); });
    if (pixels.length === 2) { canvas.lineWidth = 2; canvas.beginPath(); pixels.forEach(([x, y]) => canvas.lineTo(x, y)); canvas.stroke(); }
  }
  drawFrustum(canvas, photo) {
    const [apex, ...corners] = this.frustum(photo);
    if (!apex || corners.includes(null)) return;
    canvas.strokeStyle = photo.held_out ? "#f09a55" : "#7db4dd";
    canvas.lineWidth = 1.3;
    canvas.beginPath();
    corners.forEach(([x, y], index) => {
      const next = corners[(index + 1) % 4];
      canvas.moveTo(...apex); canvas.lineTo(x, y); canvas.lineTo(...next);
    });
    canvas.stroke();
  }
  /** Returns the number of the photo whose frustum is nearest to a pixel, within 14 pixels of its middle or apex. */
  photoAt([x, y]) {
    const nearest = { index: -1, away: 14 };
    this.scene.photos.forEach((photo, index) => {
      const [apex, ...corners] = this.frustum(photo);
      if (!apex || corners.includes(null) || photo === this.fixed) return;
      const middle = [0, 1].map((axis) => corners.reduce((sum, corner) => sum + corner[axis], 0) / 4);
      const away = Math.min(...[apex, middle].map((pixel) => Math.hypot(pixel[0] - x, pixel[1] - y)));
      if (away < nearest.away) Object.assign(nearest, { index, away });
    });
    return nearest.index;
  }

  // ---- distances

  async mark(pixel) {
    if (!this.shown) return;
    const { run, field, camera, cam_from_world } = this.shown;
    const inside = [clamp(Math.floor(pixel[0]), 0, camera.width - 1), clamp(Math.floor(pixel[1]), 0, camera.height - 1)];
    const mark = { camera, cam_from_world, pixel: inside };
    const picked = await this.asked("pick", { run, field, ...mark });
    if (!picked) return;
    if (!picked.point) return this.tell("The field has no surface there on which its retrainings agree.");
    this.marks = [...(this.marks.length === 2 ? [] : this.marks), { ...mark, point: picked.point }];
    this.drawOverlay();
    if (this.marks.length < 2) return this.tell("Mark a second point.");
    const marks = this.marks.map(({ point, ...mark }) => mark);
    const distance = await this.asked("distance", { run, field, marks });
    if (distance) this.tell(this.distance(distance));
  }
  /** Returns an answer; null if it is a refusal, which is told. */
  async asked(address, body) {
    const response = await post(address, body);
    const why = await refused(response);
    if (why) this.tell(why);
    return why ? null : response.json();
  }
  tell(text) { byId("view-distance").textContent = text; }
  /** Returns the distance of the two marks in words, with its interval or how far the retrainings differ in it. */
  distance({ length, interval, spread, members, by_pairs }) {
    const unit = this.scene.metres_per_unit ? " m" : "";
    const number = (value) => Number((value * this.scale).toPrecision(3));
    const text = this.scene.metres_per_unit ? `${number(length)} m` : `${number(length)} units of the scene: no scale`;
    const differ = spread === null ? "" : `; the ${members} retrainings differ by ${number(spread)}${unit} (standard deviation)`;
    const within = interval ? `; 90 % interval ${number(interval[0])} to ${number(interval[1])}${unit}` : differ;
    const pairs = by_pairs ? `; pairs of photos measured ${by_pairs} of the 2 points` : "";
    return `Distance: ${text}${within}${pairs}.`;
  }

  // ---- input

  /** Shows the place that the user has moved to: splats if there are some, and the field's picture at rest. */
  moved() {
    this.leavePhoto();
    if (!this.scene) return;
    this.makeSplats().catch(() => this.saySplats("The server does not answer any more."));
    if (!this.hasSplats || this.mode !== "color") return this.draw();
    this.pictures.stop();
    this.drawSplats(this.view(), true);
    clearTimeout(this.rest);
    this.rest = setTimeout(() => this.draw(), REST_MS);
  }
  /** Returns the pixel of the picture below a pointer. */
  at(event) {
    const box = this.overlay.getBoundingClientRect();
    return [((event.clientX - box.left) * this.overlay.width) / box.width, ((event.clientY - box.top) * this.overlay.height) / box.height];
  }
  listen() {
    const { overlay } = this;
    overlay.addEventListener("contextmenu", (event) => event.preventDefault());
    overlay.addEventListener("pointerdown", (event) => {
      overlay.setPointerCapture(event.pointerId);
      this.pointers.set(event.pointerId, [event.clientX, event.clientY]);
      this.travel = this.pointers.size > 1 ? Infinity : 0;
    });
    overlay.addEventListener("pointermove", (event) => this.drag(event));
    overlay.addEventListener("pointerup", (event) => this.release(event));
    overlay.addEventListener("pointercancel", (event) => this.pointers.delete(event.pointerId));
    overlay.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.mover?.zoom(Math.exp(event.deltaY * 0.001));
      this.moved();
    }, { passive: false });
    overlay.addEventListener("keydown", (event) => this.key(event));
    overlay.addEventListener("keyup", (event) => this.keys.delete(event.code));
    overlay.addEventListener("blur", () => this.keys.clear());
    byId("view-mode").addEventListener("change", () => this.showMode());
    byId("view-size").addEventListener("change", () => this.draw());
    byId("view-field").addEventListener("change", () => { this.marks = []; this.open(); });
    byId("view-frusta").addEventListener("change", () => this.shown && this.drawOverlay());
    byId("view-photo").addEventListener("change", (event) => (event.target.value ? this.toPhoto(Number(event.target.value)) : this.moved()));
    byId("view-start").addEventListener("click", () => this.scene && this.toStart());
    byId("view-measure").addEventListener("click", () => this.measure(!this.measuring));
    byId("view-bookmark").addEventListener("click", () => this.bookmark());
    byId("view-download").addEventListener("click", () => this.download());
  }
  measure(on) {
    this.measuring = on;
    this.marks = [];
    byId("view-measure").setAttribute("aria-pressed", String(on));
    this.overlay.classList.toggle("measuring", on);
    this.tell(on ? "Mark a point: click, or M for the middle." : "");
    if (this.shown) this.drawOverlay();
  }
  drag(event) {
    const last = this.pointers.get(event.pointerId);
    if (!last || !this.mover) return;
    const now = [event.clientX, event.clientY];
    const [dx, dy] = [now[0] - last[0], now[1] - last[1]];
    const others = [...this.pointers].filter(([id]) => id !== event.pointerId).map(([, place]) => place);
    this.pointers.set(event.pointerId, now);
    this.travel += Math.hypot(dx, dy);
    if (this.travel < 4) return;
    // A drag over the whole width moves what is in the middle by as much as the picture shows of it.
    const across = this.mover.distance / this.overlay.clientWidth;
    if (others.length) {
      const apart = (place) => Math.hypot(place[0] - others[0][0], place[1] - others[0][1]) || 1;
      this.mover.zoom(apart(last) / apart(now));
      this.mover.move([(-dx * across) / 2, (-dy * across) / 2, 0]);
    } else if (event.shiftKey || event.buttons & 6) this.mover.move([-dx * across, -dy * across, 0]);
    else this.mover.orbit(dx * 0.006, dy * 0.006 * -1);
    this.moved();
  }
  release(event) {
    const was = this.pointers.delete(event.pointerId);
    if (!was || this.travel >= 4 || !this.shown) return;
    if (this.measuring) return this.mark(this.at(event));
    const index = byId("view-frusta").checked ? this.photoAt(this.at(event)) : -1;
    if (index >= 0) this.toPhoto(index);
  }
  key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey || !this.mover) return;
    if (event.key === "0") return this.toStart();
    if (event.code === "KeyM") {
      if (!this.measuring) this.measure(true);
      return this.mark([this.overlay.width / 2, this.overlay.height / 2]);
    }
    if (!(event.code in KEYS)) return;
    event.preventDefault();
    const first = this.keys.size === 0;
    this.keys.add(event.code);
    if (first) { this.before = performance.now() - 16; this.fly(this.before + 16); }
  }
  /** Moves as long as keys are held: half the distance to what is looked at in a second. */
  fly(now) {
    if (this.keys.size === 0) return;
    const seconds = Math.min(0.1, (now - this.before) / 1000);
    this.before = now;
    for (const code of this.keys) KEYS[code](this.mover, seconds, 0.5 * this.mover.distance * seconds);
    this.moved();
    requestAnimationFrame((time) => this.fly(time));
  }

  // ---- bookmarks

  bookmark() {
    if (!this.shown) return;
    const { camera, cam_from_world } = this.place();
    const of = { run: this.shown.run, field: this.scene.node, scene: this.scene.scene };
    this.bookmarks.push({ name: String(this.bookmarks.length + 1).padStart(4, "0"), of, camera, cam_from_world });
    byId("view-download").disabled = false;
    const mark = this.bookmarks.at(-1);
    const button = document.createElement("button");
    Object.assign(button, { type: "button", textContent: `View ${mark.name}` });
    button.addEventListener("click", () => {
      this.mover.look(centreOf(mark.cam_from_world), mark.cam_from_world[2].slice(0, 3), this.mover.distance);
      this.moved();
    });
    const item = document.createElement("li");
    item.append(button);
    byId("view-bookmarks").append(item);
  }
  download() {
    const link = document.createElement("a");
    link.href = URL.createObjectURL(new Blob([JSON.stringify(this.bookmarks, null, 1)], { type: "application/json" }));
    link.download = "bookmarks.json";
    link.click();
    URL.revokeObjectURL(link.href);
  }
}

if (byId("view-stage")) new View(Number(byId("live").dataset.run)).open();
