// Draws a sensor as a box with its axes printed on it, and a bubble level, from directions that point up.
// A direction is [x, y, z] in the frame of the fixture, g; level is [0, 0, 1].
"use strict";

const SVG = "http://www.w3.org/2000/svg";
const HALF = [100, 72, 26];                       // half of the box along each axis, drawing units
const TURN = -0.5, LIFT = 0.8;                     // where the eye is: round the vertical, and above level, radians
const FACES = [                                   // outward normal, and right and up of what is printed on it
  {n: [0, 0, 1], u: [1, 0, 0], v: [0, 1, 0], print: "top"},
  {n: [0, 0, -1], u: [1, 0, 0], v: [0, -1, 0], print: "underside"},
  {n: [1, 0, 0], u: [0, 1, 0], v: [0, 0, 1], print: "+X"},
  {n: [-1, 0, 0], u: [0, -1, 0], v: [0, 0, 1], print: "−X"},
  {n: [0, 1, 0], u: [-1, 0, 0], v: [0, 0, 1], print: "+Y"},
  {n: [0, -1, 0], u: [1, 0, 0], v: [0, 0, 1], print: "−Y"},
];

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const plus = (a, b, by = 1) => a.map((value, i) => value + by * b[i]);
const unit = (a) => a.map((value) => value / (Math.hypot(...a) || 1));

function element(parent, name, attributes, text) {
  const made = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  if (text !== undefined) made.textContent = text;
  return parent.appendChild(made);
}

// The axes of the world in the frame of the box: x to the right, as far as the box's own x axis is level; z up.
function worldAxes(up) {
  const z = unit(up);
  const level = Math.abs(z[0]) < 0.98 ? [1, 0, 0] : [0, 0, -Math.sign(z[0])];
  const x = unit(plus(level, z, -dot(level, z)));
  return [x, cross(z, x), z];
}

// A point of the world on the drawing: right, down, and towards the eye.
function seen([x, y, z]) {
  const right = x * Math.cos(TURN) - y * Math.sin(TURN), away = x * Math.sin(TURN) + y * Math.cos(TURN);
  return [right, -(z * Math.cos(LIFT) + away * Math.sin(LIFT)), z * Math.sin(LIFT) - away * Math.cos(LIFT)];
}

function drawBox(svg, up) {
  svg.replaceChildren();
  const table = [[-130, -130], [130, -130], [130, 130], [-130, 130]].map(([x, y]) => seen([x, y, -95]).slice(0, 2));
  element(svg, "polygon", {class: "table", points: table.join(" ")});
  if (!up) return;
  const world = worldAxes(up);
  const place = (point) => seen(world.map((axis) => dot(axis, point)));
  const foot = seen([0, 0, -95]);
  element(svg, "ellipse", {class: "shadow", cx: foot[0], cy: foot[1], rx: 95, ry: 68});
  for (const face of FACES.filter(({n}) => place(n)[2] > 1e-9)) {
    const reach = (axis) => Math.abs(dot(axis, HALF));
    const centre = place(face.n.map((value, i) => value * HALF[i]));
    const [u, v] = [place(face.u), place(face.v)];
    const group = element(svg, "g", {
      class: "face " + (face.print.length > 2 ? face.print : "side"),
      transform: `matrix(${[u[0], u[1], -v[0], -v[1], centre[0], centre[1]].map((value) => value.toFixed(4))})`,
    });
    const [w, h] = [reach(face.u), reach(face.v)];
    element(group, "rect", {x: -w, y: -h, width: 2 * w, height: 2 * h, rx: 6});
    if (face.print === "top") printAxes(group);
    else element(group, "text", {y: 11, class: "print"}, face.print);
  }
}

function printAxes(group) {
  element(group, "path", {class: "axis", d: "M-62 40 H58 M46 30 L60 40 L46 50"});
  element(group, "path", {class: "axis", d: "M-62 40 V-44 M-72 -32 L-62 -46 L-52 -32"});
  element(group, "text", {class: "print", x: 80, y: 51}, "X");
  element(group, "text", {class: "print", x: -36, y: -34}, "Y");
  element(group, "circle", {class: "axis", cx: 50, cy: -28, r: 11});
  element(group, "circle", {class: "dot", cx: 50, cy: -28, r: 3.5});
  element(group, "text", {class: "print", x: 78, y: -17}, "Z");
}

const BUBBLE = 26, RING = 30, EDGE = 108, FARTHEST = 30;

// Within the tolerance in proportion, beyond it by the logarithm: a little too far and thirty times too far are both seen.
function radius(share) {
  if (share <= 1) return RING * share;
  return RING + (EDGE - RING) * Math.min(1, Math.log(share) / Math.log(FARTHEST));
}

// `sensors` have how far the two sides are too high, the share of the tolerance by which they are off, and whether that is ok.
function drawBubble(svg, [first, second], sensors) {
  svg.replaceChildren();
  element(svg, "circle", {class: "vial", r: EDGE + BUBBLE});
  element(svg, "path", {class: "cross", d: `M${-EDGE - 20} 0 H${EDGE + 20} M0 ${-EDGE - 20} V${EDGE + 20}`});
  element(svg, "text", {class: "side", x: EDGE + 8, y: -8}, first);
  element(svg, "text", {class: "side", x: 20, y: -EDGE - 4}, second);
  const drawn = sensors.filter(({sides, share}) => sides.length && share !== null);
  const within = drawn.length > 0 && sensors.every(({ok}) => ok);
  // A bubble that is within its tolerance lies wholly inside the ring.
  const r = drawn.length > 1 ? BUBBLE * 0.62 : BUBBLE;
  element(svg, "circle", {class: within ? "ring within" : "ring", r: RING + r});
  for (const {sides: [right, up], share, ok} of drawn) {
    const by = radius(share) / (Math.hypot(right, up) || 1);
    element(svg, "circle", {class: ok ? "bubble within" : "bubble", cx: right * by, cy: -up * by, r});
  }
  element(svg, "circle", {class: "middle", r: 3});
}

// The directions that are met (filled) and missing, and the present one, on the two halves of the sphere, in true areas.
function drawSphere(svg, dots, now) {
  svg.replaceChildren();
  for (const [x, name] of [[-74, "+Z half"], [74, "−Z half"]]) {
    element(svg, "circle", {class: "vial", cx: x, r: 68});
    element(svg, "text", {class: "side", x, y: 88}, name);
  }
  for (const [[x, y, z], kind] of [...dots.map(([at, met]) => [at, met ? "met" : "missing"]), ...(now ? [[now, "here"]] : [])]) {
    const r = 64 * Math.sqrt(1 - Math.min(1, Math.abs(z))) / (Math.hypot(x, y) || 1);
    element(svg, "circle", {class: kind, cx: (z < -1e-9 ? 74 : -74) + r * x, cy: -r * y, r: kind === "here" ? 9 : 6});
  }
}
