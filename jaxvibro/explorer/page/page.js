// Page: show records of the server and send the actions of the user. The page computes nothing.
"use strict";

const $ = (id) => document.getElementById(id);
const token = new URLSearchParams(location.search).get("token");
const state = {};
const pictures = {};
const far = {};
const REPLACED = ["pick", "start", "set"];  // of two consecutive messages of one kind only the later counts
let socket = null, page = "", sent = 0, answered = 0, begun = {}, held = null;
window.jaxvibro = { state, pictures, get idle() { return sent === answered && !held; }, latest: {} };

function say(message) {
  if (!socket || socket.readyState !== 1) return;
  const kind = (one) => `${one.do} ${one.panel} ${one.name}`;
  if (held && kind(held) !== kind(message)) pass();
  if (REPLACED.includes(message.do) && sent > answered) held = message;
  else send(message);
}

function wait() {  // show that an answer is late
  if (socket.readyState === 1) $("status").textContent = Object.values(begun).some(isLate) ? "Compiling" : "";
}

function isLate(since) { return performance.now() - since >= 399; }

function pass() {
  const message = held;
  held = null;
  if (message) send(message);
}

function send(message) {
  message.number = ++sent;
  begun[sent] = performance.now();
  socket.send(JSON.stringify(message));
  setTimeout(wait, 400);
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
    [held, begun] = [null, {}];
    Object.values(panels).forEach((one) => one.size());
    say({ do: "hello", text: sessionStorage.getItem("jaxvibro") || "" });
  };
  socket.onmessage = (event) => hear(JSON.parse(event.data));
  socket.onclose = () => {
    document.body.classList.add("lost");
    $("status").textContent = "connection lost: trying again; the calls are kept";
    setTimeout(connect, 1000);
  };
}

function hear(record) {
  if (record.kind === "page") page = record.name;
  else if (record.kind === "answer") {
    answered = Math.max(answered, record.number);
    window.jaxvibro.latest = { number: record.number, ms: performance.now() - begun[record.number] };
    for (const key of Object.keys(begun)) if (key <= record.number) delete begun[key];
    wait();
    if (sent === answered) pass();
    if (menu && answered >= menu.number) popup();
  } else if (record.kind === "told") { tell(record.text, record.bad); pass(); }
  else if (record.kind === "progress") { far[record.work] = record.far; works(); }
  else if (record.kind === "picture") panels[record.panel].show(record);
  else if (record.kind === "state") show(record);
}

function works() {
  const told = (state.works || []).map((one) => one.label + (far[one.work] ? ` (${far[one.work]})` : ""));
  $("works").textContent = told.length ? `Running: ${told.join("; ")}` : "";
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
  if (has("max_period")) $("max_period").value = state.max_period;
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

function listed(text, does) {  // list item with a button
  const item = document.createElement("li");
  item.append(Object.assign(document.createElement("button"), { textContent: text, onclick: does }));
  return item;
}

function actions() {
  return state.actions.map(({ call, label }) => {
    const item = listed(label, () => { hide(); ask(call); });
    item.firstChild.dataset.call = call;
    return item;
  });
}

function ask(call) {
  if (!$("count").reportValidity() || !$("max_period").reportValidity()) return;
  tell("", false);
  say({ do: "ask", call, count: Number($("count").value), max_period: Number($("max_period").value) });
}

function points() {
  const found = state.points.map((one) => {
    const told = `${one.kind} ${one.value.toPrecision(9)}  ${one.label}: ${one.meaning}`;
    const item = listed(told, () => say({ do: "choose", of: one.of }));
    item.firstChild.setAttribute("aria-current", one.of === state.chosen);
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

const panels = Object.fromEntries(["diagram", "plane", "portrait", "trace"].map((name) => [name, new Panel(name)]));

let menu = null;  // requested menu: position, and number of the message after which it opens

function ordered(event) {
  pass();
  menu = { left: event.pageX, top: event.pageY, number: sent };
  if (sent === answered) popup();
}

function popup() {
  const at = $("popup"), wide = document.documentElement.clientWidth;
  at.replaceChildren(...actions());
  at.hidden = false;
  const left = Math.max(0, Math.min(menu.left, wide - at.offsetWidth - 4));
  Object.assign(at.style, { left: `${left}px`, top: `${menu.top}px` });
  menu = null;
  at.querySelector("button")?.focus();
}

function hide() { menu = null; $("popup").hidden = true; }

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
  if (event.key === "Escape") {
    if ($("popup").hidden && !$("files").open) say({ do: "stop" });
    hide();
    $("files").open = false;
    return;
  }
  const isField = event.target.matches("input:not([type=range]), select");
  if (isField || event.ctrlKey || event.metaKey || event.altKey) return;
  const calls = { f: "follow", w: "switch", l: "locus", m: "margin", e: "explore" };
  if (event.key === "u") say({ do: "undo" });
  else if (calls[event.key]) ask(calls[event.key]);
};
document.addEventListener("pointerdown", (event) => {
  if (!$("popup").contains(event.target)) hide();
  if (!$("files").contains(event.target)) $("files").open = false;
});
connect();
