// Shows the state that tiltcal sends, and sends an answer to the question in it. The page itself keeps no state of the session.
"use strict";

const $ = (selector) => document.querySelector(selector);
const CHOICES = {                                  // by question: key, answer, words
  position: [["Enter", "ready", "Measure"], ["a", "typed", "angle, temperature"], ["b", "back", "back"], ["q", "quit", "stop and keep"]],
  rotation: [["Enter", "ready", "The stage turns"], ["q", "quit", "stop and keep"]],
  poll: [["s", "stop", "Stop and use the turns so far"], ["q", "quit", "stop and keep"]],
  review: [["Enter", "accept", "Accept"], ["r", "redo", "redo"], ["b", "back", "back"], ["q", "quit", "stop and keep"]],
  write: [["Enter", "yes", "Write"], ["b", "back", "back"], ["n", "quit", "stop and keep"]],
  stop: [["b", "back", "back"], ["q", "quit", "stop and keep"]],
  afterwards: [["v", "verify", "Verify"], ["r", "report", "Write the report"], ["f", "finish", "Finish"]],
};
const AGAIN = ["position", "review", "write", "stop"];  // questions at which an accepted position is taken again by a click
const UNTOUCHED = 250;                             // ms in which a new question takes no key: it was meant for the one before
const SILENT = 5000;                               // ms without a sign after which the connection is lost
const SURE = 4000;                                 // ms in which a stop is pressed a second time
const TRACED = 10000;                              // ms of the traces beside the bar of stillness
const STEADY = 0.02;                               // g that fill a trace at least (1°): the noise of a still sensor is small in it

let state = null, asked = "", since = 0, heard = 0, sending = false, stopping = 0, pressed = "", stream = null;

function make(parent, name, text = "", className = "") {
  const made = document.createElement(name);
  made.textContent = text;
  if (className) made.className = className;
  return parent.appendChild(made);
}

function choices(question) {
  return (CHOICES[question?.ask] ?? []).filter(([, word]) => word !== "verify" || question.verify);
}

// ---- the connection

function connect() {
  stream?.close();
  stream = new EventSource("events");
  heard = Date.now();
  stream.onmessage = (event) => { alive(); show(JSON.parse(event.data)); };
  stream.addEventListener("alive", alive);
  stream.onerror = async () => {
    lost();
    if (state?.ended) { stream.close(); return setTimeout(connect, 2000); }
    if (stream.readyState !== EventSource.CLOSED) return;
    const answer = await fetch("who").catch(() => null);
    if (answer?.status === 401) $("#token").hidden = false, $("#lost").hidden = true, $("main").hidden = true;
    else setTimeout(connect, 1000);
  };
}

function alive() {
  heard = Date.now();
  document.body.className = "live";
  $("#lost").hidden = $("#token").hidden = true;
  $("main").hidden = $("header").hidden = false;
  $("#link").textContent = "connected";
}

function lost() {
  document.body.className = state?.ended ? "ended" : "lost";
  $("#lost").hidden = Boolean(state?.ended) || !state;
  $("#link").textContent = state?.ended ? "the session has ended" : "no connection";
  for (const button of document.querySelectorAll("#answers button")) button.disabled = true;
}

setInterval(() => { if (stream && Date.now() - heard > SILENT) { lost(); if (!state?.ended) connect(); } }, 500);

async function send(path, content) {
  const how = {method: "POST", headers: {"Content-Type": "application/json"}, body: JSON.stringify(content)};
  const got = await fetch(path, how).catch(() => null);
  return {status: got?.status ?? 0, words: got ? await got.text().catch(() => "") : ""};
}

async function openWith(token) {
  if ((await send("token", {token})).status === 204) return connect();
  $("#token").hidden = false;
  $("#wrong").textContent = "This is not the token.";
}

$("#positions").onclick = ({target}) => {
  const name = target.textContent;
  if (target.className === "" && state.question?.ask === "position") return answer("again", {position: name});
  if (target.className !== "done" || !AGAIN.includes(state.question?.ask)) return;
  if (pressed === name) return answer("again", {position: name});
  pressed = name;
  $("#said").textContent = `Press ${name} again to withdraw it and take it anew.`;
};
$("#token").onsubmit = (event) => { event.preventDefault(); openWith(new FormData(event.target).get("token").trim()); };

// ---- answers

// Sends an answer; returns why tiltcal cannot read what was typed with it.
async function answer(word, more = {}) {
  const question = state?.question;
  if (!question || sending || document.body.className !== "live" || performance.now() - since < UNTOUCHED) return;
  if (word === "typed") return type(question);
  if (word === "quit" && Date.now() - stopping > SURE) {
    stopping = Date.now();
    $("#said").textContent = "Press it again to stop. Everything measured is kept.";
    return;
  }
  sending = true;
  for (const button of document.querySelectorAll("#answers button")) button.disabled = true;
  const {status, words} = await send("answer", {id: question.id, answer: word, ...more});
  sending = false;
  if (status === 422) {
    for (const button of document.querySelectorAll("#answers button")) button.disabled = false;
    return words;
  }
  if (status !== 204) {
    $("#said").textContent = status === 409 ? "This was answered already." : "tiltcal did not say that it arrived: look what it asks now.";
    asked = "";
    show(state);
  }
}

// Asks what was actually set; what is left empty is as it was asked for. What tiltcal cannot read is said at its field.
function type(question) {
  const fields = $("#fields"), dialog = $("#type");
  const axes = question.tilt ? Object.entries(question.tilt).map(([axis, angle]) => [axis, `Tilt of ${axis}, asked ${angle}`, "°", `tilt of ${axis}`])
    : ["x", "y", "z"].map((axis, i) => [axis, `Direction that points up, ${axis}`, "", `gravity ${i + 1}`]);
  fields.replaceChildren();
  for (const [name, label, unit, key] of [...axes, ["temperature", "Temperature", "°C", "temperature"]]) {
    const row = make(fields, "label", `${label} `);
    Object.assign(make(row, "input"), {name, autocomplete: "off"}).dataset.key = key;
    row.append(` ${unit}`);
  }
  $("#unread").textContent = "";
  $("#type form").onsubmit = async (event) => {
    if (event.submitter?.value !== "keep") return;
    event.preventDefault();
    const inputs = [...fields.querySelectorAll("input")];
    const {temperature, ...set} = Object.fromEntries(inputs.map(({name, value}) => [name, value.trim()]));
    const typed = Object.entries(set).filter(([, text]) => text);
    const attitude = !typed.length ? {} : question.tilt ? {tilt: Object.fromEntries(typed)} : {gravity: Object.values(set)};
    const unread = await answer("ready", temperature ? {...attitude, temperature} : attitude) ?? "";
    $("#unread").textContent = unread || (document.body.className === "live" ? "" : "No connection to tiltcal: this was not taken.");
    for (const input of inputs) input.ariaInvalid = String(unread.startsWith(`${input.dataset.key}:`));
    fields.querySelector("[aria-invalid=true]")?.focus();
  };
  dialog.showModal();
}

document.addEventListener("keydown", (event) => {
  wake();
  if (event.repeat || event.ctrlKey || event.metaKey || event.altKey || $("dialog[open]") || event.target.tagName === "INPUT") return;
  if (event.key === "Enter" && ["A", "BUTTON", "SUMMARY"].includes(event.target.tagName)) return;
  if (event.key === "?") return help();
  const pressed = event.key.toLowerCase() === "t" ? "a" : event.key.toLowerCase();  // as at the terminal
  const choice = choices(state?.question).find(([key]) => key.toLowerCase() === pressed);
  if (choice) event.preventDefault(), answer(choice[1]);
});
document.addEventListener("pointerdown", wake);

function help() {
  const offered = choices(state?.question);
  $("#help p").textContent = offered.length ? "Keys" : "tiltcal is measuring: no key is taken at the moment.";
  $("#help dl").replaceChildren();
  for (const [key, , words] of offered) make($("#help dl"), "dt", key), make($("#help dl"), "dd", words);
  $("#help").showModal();
}

// ---- sound, and a screen that stays on

let audio = null, silent = false, lock = null;

function wake() {
  if (!audio && !silent) audio = new AudioContext(), sounding();
  if (audio?.state === "suspended") audio.resume();
  if (!lock && navigator.wakeLock) navigator.wakeLock.request("screen").then((got) => { lock = got; got.onrelease = () => { lock = null; }; }, () => {});
}
document.addEventListener("visibilitychange", () => { if (!document.hidden && audio) wake(); });

function sounding() {
  $("#sound").setAttribute("aria-pressed", String(Boolean(audio)));
  $("#sound").textContent = audio ? "sound on" : "sound off";
}
$("#sound").onclick = () => { $("#sound").blur(); silent = Boolean(audio) && $("#sound").dataset.first !== "1"; $("#sound").dataset.first = ""; if (silent) audio.close(), audio = null; else wake(); sounding(); };
$("#sound").onpointerdown = () => { $("#sound").dataset.first = audio ? "" : "1"; };

const TONES = {sampled: [[880, 0, 0.12], [1320, 0.13, 0.2]], refused: [[220, 0, 0.25], [165, 0.28, 0.45]], done: [[660, 0, 0.15], [880, 0.16, 0.15], [1320, 0.32, 0.4]]};

function sound(name) {
  document.documentElement.dataset.sound = name;
  for (const [pitch, start, length] of audio ? TONES[name] : []) {
    const tone = audio.createOscillator(), volume = audio.createGain(), from = audio.currentTime + start;
    tone.type = name === "refused" ? "square" : "sine";
    tone.frequency.value = pitch;
    volume.gain.setValueAtTime(name === "refused" ? 0.2 : 0.5, from);
    volume.gain.exponentialRampToValueAtTime(0.001, from + length);
    tone.connect(volume).connect(audio.destination);
    tone.start(from);
    tone.stop(from + length);
  }
}

// ---- what is seen

function show(next) {
  const before = state;
  state = next;
  if (before?.session === next.session) {
    for (const name of Object.keys(TONES)) if ((next.sounds[name] ?? 0) > (before.sounds[name] ?? 0)) sound(name);
  }
  const question = next.question, guide = next.guide;
  const id = question ? question.id : "";
  if (id !== asked) {
    asked = id;
    since = performance.now();
    stopping = 0, pressed = "";
    $("#said").textContent = "";
    if (before && $("#type").open) $("#type").close("");
    showAnswers(question);
  }
  $("#title").textContent = document.title = next.title;
  $("#hands").hidden = !next.hands_free;
  $("#remaining").textContent = next.remaining ?? "";
  $("#step").textContent = next.step;
  $("#prompt").textContent = next.prompt;
  $("#conditions").textContent = next.conditions.join(" · ");
  $("#doing").textContent = next.doing + (!next.soak ? "" : `, ${duration(next.soak)} at least`);
  $("#pictures").hidden = !guide;
  $("#state").hidden = !guide && !next.doing && !next.refused;
  if (guide) showGuide(guide);
  showOff(guide, next);
  const [taken, wanted] = next.samples ?? [0, 0];
  $("#samples").hidden = !next.samples;
  bar($("#samples .bar"), taken / (wanted || 1), false);
  $("#samples span").textContent = `${taken} of ${wanted}`;
  list($("#positions"), next.positions.map((name) => [name, next.accepted.includes(name) ? "done" : name === next.now ? "now" : ""]));
  list($("#log"), [...next.log].reverse().map(({text, kind}) => [text, kind]));
  $("#sphere").hidden = !next.sphere;
  if (next.sphere) {
    drawSphere($("#sphere svg"), next.sphere.dots, guide?.sensors[0]?.present);
    $("#sphere figcaption").textContent = next.sphere.share === null ? "" : `${Math.round(100 * next.sphere.share)} % of the sphere met`;
  }
  showTable(next.table);
  showResults(next);
  if (next.ended) lost();
  requestAnimationFrame(() => { document.documentElement.dataset.lag = next.read_ms ? Date.now() - next.read_ms : ""; });
}

function showAnswers(question) {
  const place = $("#answers");
  place.replaceChildren();
  for (const [key, word, words] of choices(question)) {
    const button = make(place, "button", words, key === "Enter" ? "main" : "");
    make(button, "kbd", key === "Enter" ? "⏎" : key);
    button.dataset.answer = word;
    button.type = "button";
    button.onclick = () => { button.blur(); answer(word); };
  }
}

function showGuide(guide) {
  const presents = guide.sensors.map(({present}) => present).filter(Boolean);
  const mean = presents.length ? unit(presents.reduce((a, b) => plus(a, b))) : null;
  $("#set").hidden = !guide.target;
  $("#level").hidden = !guide.target || !guide.worst;
  drawBox($("#now svg"), mean);
  $("#now").classList.toggle("none", !mean);
  bar($("#still .bar"), guide.still, guide.still >= 1);
  drawTrace(mean);
  if (!guide.target) return;
  drawBox($("#set svg"), guide.target);
  if (!guide.worst) return $("#each").replaceChildren();
  const each = $("#each");
  each.replaceChildren();
  for (const {name, said, ok} of guide.sensors.length > 1 ? guide.sensors : []) {
    const chip = make(each, "span", `${name} `, ok === null ? "" : ok ? "good" : "bad");
    make(chip, "b", ok ? "ok" : said);
  }
  drawBubble($("#level svg"), guide.sides, guide.sensors);
  const shown = guide.sensors.filter(({sides}) => sides.length);
  const away = guide.sides.map((side, i) => [side, shown.reduce((sum, {sides}) => sum + sides[i], 0) / shown.length]);
  $("#advice").textContent = guide.note || guide.fits ? guide.note : away.filter(([, by]) => Math.abs(by) > guide.worst.tolerance / 4)
    .map(([side, by]) => `${by > 0 ? "lower" : "raise"} ${side} by ${Math.abs(by).toFixed(Math.abs(by) > 10 ? 0 : 1)}°`).join(", ");
}

// The last seconds of the direction that points up, in which a loose wire jumps; each trace about its own mean.
let trace = [];

function drawTrace(up, now = performance.now()) {
  trace = [...trace, [now, up]].filter(([at]) => now - at < TRACED);
  const ups = trace.map(([, up]) => up).filter(Boolean);
  const means = [0, 1, 2].map((i) => ups.reduce((sum, up) => sum + up[i], 0) / ups.length);
  const most = Math.max(STEADY, ...ups.flatMap((up) => up.map((one, i) => Math.abs(one - means[i]))));
  const path = (i) => trace.map(([at, up], n) => !up ? "" :
    `${n && trace[n - 1][1] ? "L" : "M"}${(100 - 100 * (now - at) / TRACED).toFixed(1)},${(4 + 8 * i - 3.5 * (up[i] - means[i]) / most).toFixed(2)}`);
  document.querySelectorAll("#trace path").forEach((drawn, i) => drawn.setAttribute("d", path(i).join("")));
}

function showOff(guide, next) {
  const off = $("#off");
  off.className = next.refused ? "refused" : guide?.ok ? "good" : "";
  off.replaceChildren();
  if (next.refused) off.textContent = `refused: ${next.refused}`;
  else if (guide?.worst) {
    const {axis, angle, tolerance} = guide.worst, sign = !axis ? "" : angle < 0 ? "−" : "+", said = `${sign}${Math.abs(angle).toFixed(1)}°`;
    off.textContent = guide.ok ? "ok" : said;
    make(off, "small", [axis, guide.ok ? said : "", axis ? "" : "off", `(±${tolerance.toFixed(1)}°)`].filter(Boolean).join(" "));
  }
}

function bar(place, share, full) {
  place.className = full ? "bar full" : "bar";
  place.firstChild.style.width = `${100 * share}%`;
}

function list(place, items) {
  const text = JSON.stringify(items);
  if (place.dataset.shown === text) return;
  place.dataset.shown = text;
  place.replaceChildren();
  for (const [words, className] of items) make(place, "li", words, className);
}

function showTable(table) {
  const place = $("#readings");
  place.hidden = !table;
  if (!table) return;
  const text = JSON.stringify(table);
  if (place.dataset.shown === text) return;
  place.dataset.shown = text;
  place.replaceChildren();
  const made = make(place, "table");
  const head = make(make(made, "thead"), "tr"), body = make(made, "tbody");
  for (const name of table.head) make(head, "th", name);
  for (const {cells, ok} of table.rows) {
    const row = make(body, "tr");
    cells.forEach((cell, i) => {
      const made = make(row, "td", cell);
      if (!i && ok !== null) make(made, "b", ok ? "ok" : "off", ok ? "good" : "bad");
    });
  }
}

function showResults(next) {
  const place = $("#results");
  const text = JSON.stringify([next.results, next.ended]);
  if (place.dataset.shown !== text) {
    place.dataset.shown = text;
    place.replaceChildren();
    for (const result of next.results) {
      const card = make(place, "div", "", "sensor");
      make(card, "h2", `${result.serial}  ${result.file}`);
      make(card, "div", "", "tilt").dataset.serial = result.serial;
      for (const line of result.uncertainty ?? []) make(card, "p", line);
      if (result.verdict) make(card, "pre", result.verdict, "verdict");
      if (result.report && next.ended) make(card, "p", `${result.report} is written`);
      else if (result.report) Object.assign(make(card, "a", `${result.report} is written: open it`), {href: `report/${encodeURIComponent(result.serial)}`, target: "_blank"});
      if (!result.summary) continue;
      const more = make(card, "details");
      make(more, "summary", "coefficients");
      make(more, "pre", result.summary);
    }
  }
  for (const tilt of place.querySelectorAll(".tilt")) {
    tilt.replaceChildren();
    for (const [name, value, half] of next.live[tilt.dataset.serial] ?? []) {
      const part = make(tilt, "span", "", name.startsWith("tilt") ? "" : "small");
      make(part, "small", name), make(part, "b", value), make(part, "small", half);
    }
  }
}

function duration(seconds) {
  const minutes = Math.round(seconds / 60);
  if (seconds < 90) return `${Math.max(0, Math.round(seconds))} s`;
  return minutes < 90 ? `${minutes} min` : `${Math.floor(minutes / 60)} h ${minutes % 60} min`;
}

const token = location.hash.slice(1);
if (token) history.replaceState(null, "", "/"), openWith(token);
else connect();
