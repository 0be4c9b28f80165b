// The page: shows what the server tells, and tells it what the user does. It computes nothing.
"use strict";

const $ = (id) => document.getElementById(id);
const token = new URLSearchParams(location.search).get("token");
const state = {};
const pictures = {};
const far = {};
let socket = null, page = "", sent = 0, answered = 0, begun = {};
window.jaxvibro = { state, pictures, get idle() { return sent === answered; }, latest: {} };

function say(message) {
  if (!socket || socket.readyState !== 1) return;
  message.number = ++sent;
  begun[sent] = performance.now();
  socket.send(JSON.stringify(message));
}

function tell(text, bad) {
  $("told").textContent = text;
  $("told").className = bad ? "bad" : "";
}

function connect() {
  const way = location.protocol === "https:" ? "wss:" : "ws:";
  socket = new WebSocket(`${way}//${location.host}/socket?token=${encodeURIComponent(token)}`);
  socket.onopen = () => {
    document.body.classList.remove("lost");
    $("status").textContent = "";
    answered = sent;
    Object.values(panels).forEach((one) => one.size());
    say({ do: "hello", text: sessionStorage.getItem("jaxvibro") || "" });
  };
  socket.onmessage = (event) => hear(JSON.parse(event.data));
  socket.onclose = () => {
    document.body.classList.add("lost");
    $("status").textContent = "the server is gone: trying again; what was asked is kept";
    setTimeout(connect, 1000);
  };
}

function hear(record) {
  if (record.kind === "page") page = record.name;
  else if (record.kind === "answer") {
    answered = Math.max(answered, record.number);
    window.jaxvibro.latest = { number: record.number, ms: performance.now() - begun[record.number] };
    for (const key of Object.keys(begun)) if (key <= record.number) delete begun[key];
  } else if (record.kind === "told") tell(record.text, record.bad);
  else if (record.kind === "progress") { far[record.work] = record.far; works(); }
  else if (record.kind === "picture") panels[record.panel].show(record);
  else if (record.kind === "state") show(record);
}

function works() {
  const told = (state.works || []).map((one) => one.label + (far[one.work] ? ` (${far[one.work]})` : ""));
  $("works").textContent = told.length ? `at work: ${told.join("; ")}` : "";
  $("stop").hidden = !told.length;
}

function options(select, names, value) {
  if (select.dataset.names !== names.join()) {
    select.replaceChildren(...names.map((name) => new Option(name, name)));
    select.dataset.names = names.join();
  }
  select.value = value;
}

function round(value) { return Number(value.toPrecision(12)); }

function show(record) {
  Object.assign(state, record);
  const has = (key) => key in record;
  if (has("sliders")) sliders();
  if (has("numbers") || has("sliders")) numbers();
  if (has("along") || has("sliders")) {
    const names = state.sliders.map((one) => one.name), along = state.along;
    options($("parameter"), names, along.parameter);
    options($("second"), names, along.second);
    options($("variable"), state.variables, along.variable);
    [$("low").value, $("high").value] = along.bounds;
    [$("second_low").value, $("second_high").value] = along.second_bounds;
  }
  if (has("facts")) $("facts").textContent = state.facts;
  if (has("title")) $("title").textContent = state.title;
  if (has("python")) $("python").textContent = state.python;
  if (has("undo")) $("undo").disabled = !state.undo;
  if (has("works")) works();
  if (has("marks")) for (const name of ["diagram", "plane"]) panels[name].mark(state.marks[name] || []);
  if (has("actions")) $("actions").replaceChildren(...actions());
  if (has("points") || has("chosen")) points();
  if (has("file") && state.file) sessionStorage.setItem("jaxvibro", state.file);
  if (has("title")) document.title = `${state.title || "jaxvibro"} - jaxvibro`;
}

function actions() {
  return state.actions.map(({ call, label }) => {
    const item = document.createElement("li"), button = document.createElement("button");
    button.textContent = label;
    button.dataset.call = call;
    button.onclick = () => { hide(); ask(call); };
    item.append(button);
    return item;
  });
}

function ask(call) {
  tell("", false);
  say({ do: "ask", call, count: Number($("count").value), max_period: Number($("max_period").value) });
}

function points() {
  const found = state.points.map((one) => {
    const item = document.createElement("li"), button = document.createElement("button");
    button.textContent = `${one.kind} ${one.value.toPrecision(9)}  ${one.label}: ${one.meaning}`;
    button.setAttribute("aria-current", one.of === state.chosen);
    button.onclick = () => say({ do: "choose", of: one.of });
    item.append(button);
    return item;
  });
  const kept = document.activeElement && $("points").contains(document.activeElement)
    ? [...$("points").querySelectorAll("button")].indexOf(document.activeElement) : -1;
  $("points").replaceChildren(...found);
  if (kept >= 0) $("points").querySelectorAll("button")[kept]?.focus();
}

function sliders() {
  const parts = state.sliders.flatMap(({ name, low, high }) => {
    const label = document.createElement("label"), range = document.createElement("input");
    const number = document.createElement("input");
    label.textContent = name;
    label.htmlFor = range.id = `slider_${name}`;
    Object.assign(range, { type: "range", min: low, max: high, step: (high - low) / 1000 });
    Object.assign(number, { type: "number", step: "any", id: `number_${name}` });
    number.setAttribute("aria-label", name);
    range.oninput = () => { number.value = round(Number(range.value)); say(put(name, range, false)); };
    range.onchange = () => say(put(name, range, true));
    number.onchange = () => { if (number.value !== "") say(put(name, number, true)); };
    return [label, range, number];
  });
  $("sliders").replaceChildren(...parts);
}

function put(name, input, last) { return { do: "set", name, value: Number(input.value), last }; }

function numbers() {
  for (const [name, value] of Object.entries(state.numbers)) {
    const range = $(`slider_${name}`), number = $(`number_${name}`);
    if (!range) continue;
    if (document.activeElement !== range || !range.matches(":active")) range.value = value;
    if (document.activeElement !== number) number.value = round(value);
  }
}

const SVG = "http://www.w3.org/2000/svg";

class Panel {
  constructor(name) {
    this.name = name;
    this.at = $(name);
    this.img = document.createElement("img");
    this.img.alt = "";
    this.img.draggable = false;
    this.svg = document.createElementNS(SVG, "svg");
    this.at.append(this.img, this.svg);
    this.points = [];
    this.at.onpointerdown = (event) => this.down(event);
    this.at.onpointermove = (event) => this.move(event);
    this.at.onpointerup = (event) => this.up(event);
    this.at.ondblclick = () => say({ do: "zoom", panel: name });
    this.at.onkeydown = (event) => this.key(event);
    this.at.oncontextmenu = (event) => { event.preventDefault(); this.click(event); popup(event); };
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
    const found = points.map((point) => this.pixel(point)).filter((one) => this.inside(one)).map(([across, down]) => {
      const circle = document.createElementNS(SVG, "circle");
      for (const [key, value] of [["cx", `${100 * across}%`], ["cy", `${100 * down}%`], ["r", 6]])
        circle.setAttribute(key, value);
      return circle;
    });
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
    this.rect ??= this.svg.appendChild(document.createElementNS(SVG, "rect"));
    const low = [0, 1].map((k) => Math.min(here[k], this.from[k])), wide = [0, 1].map((k) => Math.abs(here[k] - this.from[k]));
    const given = { x: low[0] * area.width, y: low[1] * area.height, width: wide[0] * area.width, height: wide[1] * area.height };
    for (const [key, value] of Object.entries(given)) this.rect.setAttribute(key, value);
  }

  up(event) {
    if (!this.from) return;
    const area = this.at.getBoundingClientRect(), here = this.place(event), from = this.from;
    this.from = null;
    this.rect?.remove();
    this.rect = null;
    const wide = [Math.abs(here[0] - from[0]) * area.width, Math.abs(here[1] - from[1]) * area.height];
    if (wide[0] < 5 && wide[1] < 5) this.click(event);
    else if (wide[0] >= 5 && wide[1] >= 5) {
      const [a, b] = [this.data(from), this.data(here)];
      const pair = (k) => [Math.min(a[k], b[k]), Math.max(a[k], b[k])];
      say({ do: "zoom", panel: this.name, x: pair(0), y: pair(1) });
    }
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

const panels = Object.fromEntries(["diagram", "plane", "portrait", "trace"].map((name) => [name, new Panel(name)]));

function popup(event) {
  setTimeout(() => {  // what can be done is told once the click has been seen to
    $("popup").replaceChildren(...actions());
    Object.assign($("popup").style, { left: `${event.pageX}px`, top: `${event.pageY}px` });
    $("popup").hidden = false;
    $("popup").querySelector("button")?.focus();
  }, 300);
}

function hide() { $("popup").hidden = true; }

async function take(name) {
  const answer = await fetch(`/take/${page}/${name}?token=${encodeURIComponent(token)}`);
  if (!answer.ok) return tell(await answer.text(), true);
  const link = document.createElement("a");
  link.href = URL.createObjectURL(await answer.blob());
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10000);
}

document.querySelectorAll("[data-take]").forEach((button) => { button.onclick = () => take(button.dataset.take); });
$("undo").onclick = () => say({ do: "undo" });
$("stop").onclick = () => say({ do: "stop" });
$("start").onsubmit = (event) => {
  event.preventDefault();
  say({ do: "start", x: Number($("start_x").value), v: Number($("start_v").value) });
};
$("along").onsubmit = (event) => {
  event.preventDefault();
  const pair = (low, high) => [Number($(low).value), Number($(high).value)];
  say({ do: "along", parameter: $("parameter").value, bounds: pair("low", "high"), second: $("second").value,
    second_bounds: pair("second_low", "second_high"), variable: $("variable").value });
};
$("load").onchange = async () => {
  const file = $("load").files[0];
  if (!file) return;
  if (file.size > 1000000) tell(`${file.name}: a scene file must be at most 1,000,000 bytes long`, true);
  else say({ do: "load", text: await file.text() });
  $("load").value = "";
};
document.onkeydown = (event) => {
  if (event.key === "Escape") { hide(); say({ do: "stop" }); return; }
  if (/INPUT|SELECT|TEXTAREA/.test(event.target.tagName) || event.ctrlKey || event.metaKey || event.altKey) return;
  const calls = { f: "follow", w: "switch", l: "locus", m: "margin", e: "explore" };
  if (event.key === "u") say({ do: "undo" });
  else if (calls[event.key]) ask(calls[event.key]);
};
document.addEventListener("pointerdown", (event) => { if (!$("popup").contains(event.target)) hide(); });
connect();
