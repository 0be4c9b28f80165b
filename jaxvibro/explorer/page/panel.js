// Panel: show a figure from the server with markers, and send pointer and key actions.
"use strict";

function drawn(element, given) {
  for (const [key, value] of Object.entries(given)) element.setAttribute(key, value);
  return element;
}

function shape(kind) { return document.createElementNS("http://www.w3.org/2000/svg", kind); }

class Panel {
  constructor(name) {
    this.name = name;
    this.at = $(name);
    this.img = Object.assign(document.createElement("img"), { alt: "", draggable: false });
    this.svg = shape("svg");
    this.at.append(this.img, this.svg);
    this.points = [];
    this.at.onpointerdown = (event) => this.down(event);
    this.at.onpointermove = (event) => this.move(event);
    this.at.onpointerup = (event) => this.up(event);
    this.at.ondblclick = () => say({ do: "zoom", panel: name });
    this.at.onkeydown = (event) => this.key(event);
    this.at.oncontextmenu = (event) => { event.preventDefault(); this.click(event); ordered(event); };
    new ResizeObserver(() => this.size()).observe(this.at);
  }

  size() {
    const { width, height } = this.at.getBoundingClientRect();
    clearTimeout(this.later);
    const send = () => say({ do: "size", panel: this.name, width, height, ratio: window.devicePixelRatio || 1 });
    if (this.box) this.later = setTimeout(send, 150);
    else if (width > 0) send();
  }

  show(record) {
    this.box = record.box;
    this.x = record.x;
    this.y = record.y;
    this.img.src = `data:image/png;base64,${record.png}`;
    pictures[this.name] = (pictures[this.name] || 0) + 1;
    this.mark(this.points);
  }

  place(event) {
    const area = this.at.getBoundingClientRect();
    return [(event.clientX - area.left) / area.width, (event.clientY - area.top) / area.height];
  }

  data([across, down]) {
    const [left, top, width, height] = this.box;
    const x = this.x[0] + ((across - left) / width) * (this.x[1] - this.x[0]);
    const y = this.y[1] - ((down - top) / height) * (this.y[1] - this.y[0]);
    return [x, y];
  }

  pixel([x, y]) {
    const [left, top, width, height] = this.box;
    return [left + (width * (x - this.x[0])) / (this.x[1] - this.x[0]),
      top + (height * (this.y[1] - y)) / (this.y[1] - this.y[0])];
  }

  inside([across, down]) {
    if (!this.box) return false;
    const [left, top, width, height] = this.box;
    return across >= left && across <= left + width && down >= top && down <= top + height;
  }

  mark(points) {
    this.points = points;
    if (!this.box) return;
    const found = points.map((point) => this.pixel(point)).filter((one) => this.inside(one))
      .map(([across, down]) => drawn(shape("circle"), { cx: `${100 * across}%`, cy: `${100 * down}%`, r: 6 }));
    this.svg.replaceChildren(...found);
  }

  down(event) {
    if (event.button !== 0 || !this.box) return;
    hide();
    this.from = this.place(event);
    this.at.setPointerCapture(event.pointerId);
  }

  move(event) {
    if (!this.from) return;
    const here = this.place(event), area = this.at.getBoundingClientRect();
    this.rect ??= this.svg.appendChild(shape("rect"));
    const low = [0, 1].map((k) => Math.min(here[k], this.from[k]));
    const wide = [0, 1].map((k) => Math.abs(here[k] - this.from[k]));
    drawn(this.rect, { x: low[0] * area.width, y: low[1] * area.height, width: wide[0] * area.width,
      height: wide[1] * area.height });
  }

  up(event) {
    if (!this.from) return;
    const area = this.at.getBoundingClientRect(), here = this.place(event), from = this.from;
    this.from = null;
    this.rect?.remove();
    this.rect = null;
    const wide = [Math.abs(here[0] - from[0]) * area.width, Math.abs(here[1] - from[1]) * area.height];
    if (wide[0] < 5 && wide[1] < 5) this.once(event);
    else if (wide[0] >= 5 && wide[1] >= 5) {
      const [a, b] = [this.data(from), this.data(here)];
      const pair = (k) => [Math.min(a[k], b[k]), Math.max(a[k], b[k])];
      say({ do: "zoom", panel: this.name, x: pair(0), y: pair(1) });
    }
  }

  once(event) {  // ignore the second click of a double click
    const last = this.last, gone = last && Math.hypot(event.clientX - last.clientX, event.clientY - last.clientY);
    this.last = last && gone < 5 && event.timeStamp - last.timeStamp < 300 ? null : event;
    if (this.last) this.click(event);
  }

  click(event) {
    const place = this.place(event);
    if (!this.inside(place)) return;
    const [x, y] = this.data(place);
    tell("", false);
    if (this.name === "portrait") say({ do: "start", x, v: y });
    else if (this.name !== "trace") say({ do: "pick", panel: this.name, x, y });
  }

  key(event) {
    const moves = { ArrowLeft: { by: -1 }, ArrowRight: { by: 1 }, ArrowUp: { branch: -1 }, ArrowDown: { branch: 1 } };
    if (this.name === "diagram" && moves[event.key]) say({ do: "move", ...moves[event.key] });
    else if (event.key === "Home") say({ do: "zoom", panel: this.name });
    else return;
    event.preventDefault();
  }
}
