// What a running program does: states of nodes, progress, curves. Text from outside goes through textContent.

const byId = (id) => document.getElementById(id);
const element = (name, text = "", kind = "") => {
  const made = document.createElement(name);
  made.textContent = text;
  made.className = kind;
  return made;
};

/** Draws places and directions of cameras of a transforms.json, whose z axis is up. */
function camerasFromAbove(frames) {
  const svg = document.createElementNS("http://www.w3.org/2000/svg", "svg");
  const poses = frames.map(({ transform_matrix: [x, y] }) => ({ x: x[3], y: -y[3], ahead: [-x[2], y[2]] }));
  const [xs, ys] = [poses.map(({ x }) => x), poses.map(({ y }) => y)];
  const [left, top] = [Math.min(...xs), Math.min(...ys)];
  const size = Math.max(Math.max(...xs) - left, Math.max(...ys) - top, 1e-9);
  const step = size / 20;
  const path = document.createElementNS(svg.namespaceURI, "path");
  path.setAttribute("d", poses.map(({ x, y, ahead }) => `M${x} ${y}l${ahead[0] * step} ${ahead[1] * step}`).join(""));
  path.setAttribute("stroke-width", size / 100);
  svg.setAttribute("viewBox", [left - 2 * step, top - 2 * step, size + 4 * step, size + 4 * step].join(" "));
  svg.setAttribute("role", "img");
  svg.setAttribute("aria-label", `${poses.length} cameras from above`);
  svg.append(path);
  return svg;
}

class Live {
  constructor(run) {
    this.run = run;
    this.clear();
    const events = new EventSource("events");
    events.addEventListener("line", ({ data }) => this.line(JSON.parse(data)));
    events.addEventListener("idle", () => this.idle());
    events.addEventListener("newest", ({ data }) => this.newest(data));
    events.addEventListener("open", () => this.clear());
    events.addEventListener("error", () => this.say("The server does not answer; trying again."));
  }
  say(text) { byId("live-state").textContent = text; }
  clear() {
    this.rows = new Map();
    this.curves = new Map();
    byId("live-nodes").hidden = true;
    byId("live-nodes").tBodies[0].replaceChildren();
    byId("live-curves").replaceChildren();
    byId("live-results").replaceChildren();
    this.results = new Map();
  }
  idle() {
    for (const row of this.rows.values()) if (row.state.textContent === "waiting") this.state(row, "skipped");
    this.say(this.rows.size ? "The run has ended." : "Nothing runs in this store.");
    this.offer();
  }
  newest(number) {
    this.last = number;
    this.offer();
  }
  /** Leads to a report that is newer than this page. */
  offer() {
    if (!this.last || this.last === this.run) return;
    const link = element("a", `Run ${this.last} is done: show it`);
    link.href = "./";
    byId("live-state").replaceChildren(link);
  }
  line(event) {
    if (event.event === "began") return this.began(event);
    if (event.event === "standing") return this.say(`Running: ${this.command}: ${event.text}`);
    if (!event.node) return this.say(event.message);
    const row = this.row(event.node);
    const states = { will_run: "running", reused: "reused", finished: "ran", failed: "failed", skipped: "skipped" };
    if (states[event.event]) this.state(row, states[event.event]);
    if (event.event === "finished" && !event.node.includes("/")) this.finished(event);
    if (event.event === "progress") this.progress(row, event);
    else row.note.textContent = event.reason ?? event.message ?? (event.seconds === undefined ? "" : `${event.seconds.toFixed(1)} s`);
  }
  began({ command, nodes }) {
    this.clear();
    this.command = command;
    this.say(`Running: ${command}`);
    byId("live-nodes").hidden = false;
    nodes.forEach((name) => this.row(name));
  }
  /** Shows cameras and pictures as soon as their nodes have ended: held-out views until there is a film. */
  async finished({ node, outputs }) {
    const address = ({ digest }) => `object/${digest}`;
    if (outputs.transforms) {
      const read = await fetch(address(outputs.transforms));
      const frames = read.ok ? (await read.json()).frames : [];
      if (frames.length) this.show("cameras", [[camerasFromAbove(frames), `${node}: cameras from above`]]);
    }
    if (outputs.video && !this.results.has("film")) {
      const film = Object.assign(element("video"), { src: address(outputs.video), controls: true, loop: true, muted: true });
      this.results.delete("views");
      this.show("film", [[film, `${node}: film`]]);
    }
    const views = Object.keys(outputs).filter((name) => name.startsWith("heldout/")).slice(0, 4);
    if (!views.length || this.results.has("film")) return;
    this.show("views", views.map((name) => {
      const picture = Object.assign(element("img"), { src: address(outputs[name]), alt: `${node}: ${name}` });
      return [picture, `${node}: held-out view ${name.slice("heldout/".length)}`];
    }));
  }
  /** Replaces the results of a kind. */
  show(kind, pictures) {
    this.results.set(kind, pictures.map(([picture, caption]) => {
      const figure = element("figure");
      figure.append(picture, element("figcaption", caption));
      return figure;
    }));
    byId("live-results").replaceChildren(...[...this.results.values()].flat());
  }
  row(name) {
    if (this.rows.has(name)) return this.rows.get(name);
    const row = { name, state: element("span", "waiting", "badge waiting"), bar: document.createElement("progress"), note: element("span") };
    row.bar.hidden = true;
    row.bar.setAttribute("aria-label", `progress of ${name}`);
    const line = element("tr");
    for (const content of [element("span", name), row.state, row.bar, row.note]) {
      const cell = element("td");
      cell.append(content);
      line.append(cell);
    }
    // A child stands below its parent.
    const parent = this.rows.get(name.split("/")[0]);
    if (parent) parent.last.after(line);
    else byId("live-nodes").tBodies[0].append(line);
    row.last = line;
    if (parent) parent.last = line;
    this.rows.set(name, row);
    return row;
  }
  state(row, word) {
    row.state.textContent = word;
    row.state.className = `badge ${word}`;
    row.bar.hidden = word !== "running" || !row.bar.hasAttribute("value");
  }
  progress(row, { done, total, note }) {
    this.state(row, "running");
    Object.assign(row.bar, { max: Math.max(1, total), value: done, hidden: false });
    row.note.textContent = `${done} of ${total}${note ? `, ${note}` : ""}`;
    const psnr = /\bpsnr (\d+\.\d+)/.exec(note);
    if (psnr) this.point(row.name, done, total, Number(psnr[1]));
  }
  /** Draws PSNR against step of a training that goes on. */
  point(name, step, total, psnr) {
    if (!this.curves.has(name)) {
      const figure = element("figure");
      const svg = document.createElementNS("http://www.w3.org/2000/svg", "svg");
      const line = document.createElementNS("http://www.w3.org/2000/svg", "polyline");
      svg.setAttribute("viewBox", "0 0 400 120");
      svg.setAttribute("preserveAspectRatio", "none");
      svg.setAttribute("role", "img");
      svg.append(line);
      const caption = element("figcaption");
      figure.append(svg, caption);
      byId("live-curves").append(figure);
      this.curves.set(name, { svg, line, caption, points: [] });
    }
    const curve = this.curves.get(name);
    if (curve.points.at(-1)?.psnr !== psnr) curve.points.push({ step, psnr });
    const values = curve.points.map((point) => point.psnr);
    const [low, high] = [Math.min(...values) - 0.5, Math.max(...values) + 0.5];
    const place = (point) => `${(400 * point.step) / total},${120 - (120 * (point.psnr - low)) / (high - low)}`;
    curve.line.setAttribute("points", curve.points.map(place).join(" "));
    const text = `${name}: PSNR ${psnr} dB after ${step} of ${total} steps`;
    curve.caption.textContent = text;
    curve.svg.setAttribute("aria-label", text);
  }
}

new Live(byId("live").dataset.run);
