// Players of crowds. Each one reads the clips in its element; nothing is loaded.
"use strict";

const TRAIL_S = 4, TOGETHER_M = 5, UNKNOWN = "#9A9A9A", WALL = "#bfbfbf", INK = "#1b1f24";

for (const root of document.querySelectorAll(".player")) {
  try {
    setUp(root);
  } catch (error) {
    root.querySelector(".count").textContent = `This player does not work: ${error.message}`;
  }
}

function setUp(root) {
  const place = JSON.parse(root.querySelector("script").textContent);
  const [play, time, clock, speed] =
    [".play", ".time", ".clock", ".speed"].map((name) => root.querySelector(name));
  const drawn = ["trails", "companions", "areas"].map((name) => root.querySelector(`.${name}`));
  const sides = [...root.querySelectorAll(".side")].map((side) => ({
    canvas: side.querySelector("canvas"),
    choice: side.querySelector("select"),
    count: side.querySelector(".count"),
    people: [],
  }));
  let now = TRAIL_S, last = null, pending = 0, longest = 0;

  const draw = () => {
    const [trails, companions, areas] = drawn.map((box) => box.checked);
    for (const side of sides) drawSide(side, place, now / place.dt, { trails, companions, areas });
    time.value = now;
    clock.textContent = `${now.toFixed(1)} s`;
    time.setAttribute("aria-valuetext", clock.textContent);
  };
  const step = (at) => {
    now += ((at - (last ?? at)) / 1000) * Number(speed.value);
    last = at;
    if (now > longest) now = 0;
    draw();
    pending = requestAnimationFrame(step);
  };
  const toggle = () => {
    const starts = pending === 0;
    cancelAnimationFrame(pending);
    last = null;
    pending = starts ? requestAnimationFrame(step) : 0;
    play.textContent = starts ? "Pause" : "Play";
  };
  const choose = async (side) => {
    const clip = place.clips[Number(side.choice.value)];
    side.clip = null;  // nobody sees one crowd below the name of another
    try {
      side.people = await unpacked(clip);
    } catch (error) {
      const canvas = side.canvas;
      canvas.getContext("2d").clearRect(0, 0, canvas.width, canvas.height);
      side.count.textContent = `The clip cannot be shown: ${error.message}`;
      return;
    }
    if (clip !== place.clips[Number(side.choice.value)]) return;  // another was chosen meanwhile
    side.clip = clip;
    side.canvas.setAttribute("aria-label", `${clip.label}, seen from above`);
    longest = Math.max(...sides.map(({ clip }) => (clip ? (clip.frames - 1) * place.dt : 0)));
    time.max = longest;
    draw();
  };

  if (place.map) {
    place.picture = new Image();
    place.picture.addEventListener("load", draw);
    place.picture.src = place.map.image;
  }
  play.addEventListener("click", toggle);
  time.addEventListener("input", () => { now = Number(time.value); draw(); });
  for (const box of drawn) box.addEventListener("change", draw);
  for (const side of sides) {
    side.choice.addEventListener("change", () => choose(side));
    side.canvas.addEventListener("click", toggle);
    const [left, bottom, right, top] = place.bounds;
    const ratio = (right - left) / (top - bottom);
    side.canvas.style.aspectRatio = ratio;
    side.canvas.style.maxWidth = `min(100%, calc(${ratio} * 34em))`;  // no higher than a screen
    new ResizeObserver(draw).observe(side.canvas);
    choose(side);
  }
}

// The people of a clip; `_packed` in the Python module describes the format.
async function unpacked(clip) {
  if (clip.people) return clip.people;
  if (!("DecompressionStream" in window)) throw new Error("this browser is too old");
  const packed = Uint8Array.from(atob(clip.data), (letter) => letter.charCodeAt(0));
  const inflated = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate-raw"));
  const bytes = new Uint8Array(await new Response(inflated).arrayBuffer());
  let at = 0;
  const number = () => {
    let value = 0, shift = 0, byte;
    do {
      if (at === bytes.length) throw new Error("its data is cut off");
      byte = bytes[at++];
      value += (byte & 127) * 2 ** shift;
      shift += 7;
    } while (byte > 127);
    return value % 2 ? -(value + 1) / 2 : value / 2;
  };
  const line = (length) => {
    const values = new Int32Array(length);
    let value = 0, change = 0;
    for (let k = 0; k < length; k += 1) {
      change += number();
      value += change;
      values[k] = value;
    }
    return values;
  };
  const people = [];
  while (at < bytes.length) {
    const [first, length, goal, group, runs] = [number(), number(), number(), number(), number()];
    if (first < 0 || length < 1 || first + length > clip.frames || runs > length + 1) {
      throw new Error("its data is damaged");
    }
    const stands = new Uint8Array(length);
    for (let run = 0, k = 0; run < runs; run += 1) {
      const end = k + number();
      stands.fill(run % 2, k, end);
      k = end;
    }
    people.push({ first, length, goal: goal - 1, group, stands, x: line(length), y: line(length) });
  }
  clip.people = people;
  return people;
}

// Draw one crowd at a time `at`, in frames of its clip.
function drawSide({ canvas, count, people, clip }, place, at, shown) {
  if (!clip || !canvas.clientWidth) return;
  const view = viewOf(canvas, place);
  drawPlace(view, place, shown.areas);
  const frame = Math.min(Math.floor(at + 1e-6), clip.frames - 1);
  const dark = clip.unobserved.some(([start, stop]) => start <= frame && frame < stop);
  const here = dark ? [] : present(people, frame, Math.max(0, at - frame), view);
  const byColour = new Map();
  for (const one of here) {
    const colour = colourOf(one.person.goal, place);
    if (!byColour.has(colour)) byColour.set(colour, []);
    byColour.get(colour).push(one);
  }
  if (shown.trails) drawTrails(view, byColour, Math.round(TRAIL_S / place.dt));
  if (shown.companions) drawCompanions(view, here);
  drawPeople(view, byColour);
  const number = here.length === 1 ? "1 person" : `${here.length} people`;
  const clock = `${(clip.start_s + at * place.dt).toFixed(0)} s`;
  count.textContent = dark ? `not observed at ${clock}` : `${number}, ${clock} after the start`;
}

// A canvas in the pixels of the screen, and what turns metres and the clips' units into them.
function viewOf(canvas, place) {
  const sharp = window.devicePixelRatio || 1;
  const width = Math.round(canvas.clientWidth * sharp);
  const height = Math.round(canvas.clientHeight * sharp);
  if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
  const [left, bottom, right] = place.bounds;
  const perMetre = width / (right - left), perUnit = place.unit * perMetre;
  return {
    pen: canvas.getContext("2d"), sharp, width, height, perMetre,
    radius: Math.max(place.radius * perMetre, 2.2 * sharp),
    ofMetres: ([x, y]) => [(x - left) * perMetre, height - (y - bottom) * perMetre],
    x: (units) => units * perUnit,
    y: (units) => height - units * perUnit,
  };
}

function colourOf(goal, place) {
  return goal < 0 ? UNKNOWN : place.colours[goal % place.colours.length];
}

function drawPlace({ pen, sharp, width, height, ofMetres }, place, areas) {
  pen.fillStyle = "#fff";
  pen.fillRect(0, 0, width, height);
  if (place.picture?.naturalWidth) {
    const [left, bottom, right, top] = place.map.bounds;
    const [x, y] = ofMetres([left, top]), [u, v] = ofMetres([right, bottom]);
    pen.drawImage(place.picture, x, y, u - x, v - y);
  }
  const trace = (points) => {
    pen.beginPath();
    for (const point of points) pen.lineTo(...ofMetres(point));
    pen.closePath();
  };
  pen.fillStyle = WALL;
  for (const wall of place.walls) { trace(wall); pen.fill(); }
  if (!areas) return;
  pen.lineWidth = sharp;
  place.goals.forEach((area, k) => {
    trace(area);
    pen.strokeStyle = colourOf(k, place);
    pen.stroke();
  });
  pen.setLineDash([5 * sharp, 4 * sharp]);
  pen.strokeStyle = INK;
  for (const area of place.spawns) { trace(area); pen.stroke(); }
  pen.setLineDash([]);
}

// Who is there, and where: between two frames, people move on a straight line.
function present(people, frame, part, view) {
  const here = [];
  for (const person of people) {
    const k = frame - person.first;
    if (k < 0 || k >= person.length) continue;
    const next = Math.min(k + 1, person.length - 1);
    const between = (values) => values[k] + (values[next] - values[k]) * part;
    here.push({ person, k, x: view.x(between(person.x)), y: view.y(between(person.y)) });
  }
  return here;
}

function drawTrails({ pen, sharp, radius, x, y }, byColour, steps) {
  pen.globalAlpha = 0.4;
  pen.lineJoin = "round";
  pen.lineWidth = Math.max(sharp, radius / 3);
  for (const [colour, here] of byColour) {
    pen.beginPath();
    for (const { person, k, ...now } of here) {
      const from = Math.max(0, k - steps);
      pen.moveTo(x(person.x[from]), y(person.y[from]));
      for (let back = from + 1; back <= k; back += 1) pen.lineTo(x(person.x[back]), y(person.y[back]));
      pen.lineTo(now.x, now.y);
    }
    pen.strokeStyle = colour;
    pen.stroke();
  }
  pen.globalAlpha = 1;
}

function drawCompanions({ pen, sharp, perMetre }, here) {
  const last = new Map();
  pen.beginPath();
  for (const one of here) {
    const { group } = one.person;
    if (!group) continue;
    const other = last.get(group);
    if (other && Math.hypot(one.x - other.x, one.y - other.y) <= TOGETHER_M * perMetre) {
      pen.moveTo(other.x, other.y);
      pen.lineTo(one.x, one.y);
    }
    last.set(group, one);
  }
  pen.strokeStyle = INK;
  pen.lineWidth = 1.5 * sharp;
  pen.stroke();
}

function drawPeople({ pen, sharp, radius }, byColour) {
  pen.lineWidth = Math.max(sharp, radius / 2.5);
  for (const [colour, here] of byColour) {
    const walkers = new Path2D(), standers = new Path2D();
    for (const { person, k, x, y } of here) {
      const path = person.stands[k] ? standers : walkers;
      path.moveTo(x + radius, y);
      path.arc(x, y, radius, 0, 2 * Math.PI);
    }
    pen.fillStyle = colour;
    pen.fill(walkers);
    pen.fillStyle = "#fff";
    pen.fill(standers);
    pen.strokeStyle = colour;
    pen.stroke(standers);
  }
}
