"use strict";
// One question after the other: two clips in lock-step, an answer, the next pair, which is there already.

const $ = (id) => document.getElementById(id);
const sleep = (ms) => new Promise((done) => setTimeout(done, ms));
const AGAIN_MS = 1000, RENEW_MS = 30000, HOLD_S = 0.5, SEEN_MS = 120, SPEEDS = ["0.5", "1", "2"];
const SIDES = ["left", "right"].map($);

let key = sessionStorage.getItem("key");
let current = null; // the pair on the screen
let queue = []; // promises of those after it
let given = []; // what was answered, newest last
let busy = false; // an answer is on its way
let feedback = null; // ends the showing of what was right
let note = ""; // of what went before, shown with the next pair
let counted = null; // progress as of the last answer: pairs that were fetched before it know less
let turn = 0; // changes when the pair that was waited for is no longer wanted

// ---- the server ----

class Gone extends Error {}

async function ask(path, body) {
  // The network may be lost and the server be started anew: whatever is asked is asked until it is answered.
  for (;;) {
    let reply, data;
    try {
      reply = await fetch(path, {
        method: body ? "POST" : "GET", body: body && JSON.stringify(body),
        headers: { Authorization: `Bearer ${key}`, ...(body && { "Content-Type": "application/json" }) },
      });
      data = await reply.arrayBuffer(); // the server may die in the middle of it
    } catch {
      tell("No connection. Nothing is lost; it goes on as soon as the server answers.", "lost");
      await sleep(AGAIN_MS);
      continue;
    }
    if (reply.ok || [409, 410, 422].includes(reply.status)) { // asked again, it would answer the same
      if (document.body.dataset.state === "lost") current && !busy ? show() : tell("", "loading");
      return { reply, data };
    }
    const told = parsed(data);
    if (reply.status === 401 || reply.status === 403) throw new Gone(told.message ?? "this page is not let in");
    if (reply.status !== 503) tell(`${told.message ?? "The server has a problem"}. It is tried again.`, "lost");
    await sleep(AGAIN_MS);
  }
}

function parsed(data) {
  try { return JSON.parse(new TextDecoder().decode(data)); } catch { return {}; } // of something between
}

async function post(name, body) {
  const { reply, data } = await ask(`/api/${name}`, body);
  return { ok: reply.ok, ...parsed(data) };
}

async function clip(id) {
  const { reply, data } = await ask(`/clips/${id}.webp`);
  if (!reply.ok) return null;
  return { ...JSON.parse(reply.headers.get("Clip")), image: await createImageBitmap(new Blob([data])) };
}

async function claim(held, patient = false) {
  const told = await post("claim", { held, patient });
  if (!told.ok) return { state: "again" };
  return told.state === "question" ? loaded(told) : told;
}

async function loaded(told) {
  if (!current) tell("The clips are being drawn …");
  const clips = await Promise.all(told.clips.map(clip));
  return clips.every(Boolean) ? { ...told, drawn: clips } : { state: "again" };
}

// ---- the screen ----

function tell(text, state) {
  if (state) document.body.dataset.state = state;
  if ($("status").textContent !== text) $("status").textContent = text;
}

function reveal(shown) {
  for (const part of [$("pair"), $("choices"), $("playing")]) part.hidden = !shown;
}

function count(told) {
  const round = current?.practice ? "Practice" : "Answered";
  $("count").textContent = told.of ? `${round}: ${told.done} of ${told.of}` : "";
  $("progress").max = told.of || 1;
  $("progress").value = told.done || 0;
}

function show() {
  document.body.dataset.state = "question";
  reveal(true);
  $("task").textContent = current.task;
  tell(`${note} ${current.practice ? "Practice: which" : "Which"} does the task better?`.trim());
  count(current);
}

function present(pair) {
  current = counted?.round === pair.round ? { ...pair, ...counted } : pair;
  for (const [at, side] of SIDES.entries()) {
    const { width, height } = pair.drawn[at], canvas = side.querySelector("canvas");
    Object.assign(canvas, { width, height });
    const line = side.parentElement.querySelector(".return"), value = pair.returns?.[at];
    line.hidden = value === undefined;
    line.querySelector("data").value = String(value ?? "");
    line.querySelector("data").dataset.value = String(value ?? "");
    line.querySelector("data").textContent = value === undefined ? "" : value.toFixed(1);
  }
  $("about-returns").hidden = !pair.returns;
  mark(null);
  play.restart();
  draw();
  play.shown = performance.now();
  show();
}

function mark(choice, better) {
  for (const button of document.querySelectorAll("[data-choice]")) {
    button.classList.toggle("chosen", button.dataset.choice === choice);
    button.classList.toggle("better", button.dataset.choice === better);
  }
}

// ---- both clips, by one clock ----

const play = {
  frame: 0, loops: 0, paused: matchMedia("(prefers-reduced-motion: reduce)").matches, since: 0, shown: 0,
  get speed() { return Number(document.querySelector("[name=speed]:checked").value); },
  get frames() { return Math.max(...current.drawn.map((each) => each.frames)); },
  restart() { this.frame = 0; this.loops = 0; this.since = performance.now(); },
  step(by) {
    this.pause(true);
    this.frame = Math.min(Math.max(Math.floor(this.frame) + by, 0), this.frames - 1);
    draw();
  },
  pause(paused) {
    this.paused = paused;
    this.since = performance.now();
    $("pause").firstElementChild.textContent = paused ? "Play" : "Pause";
  },
  advance(now) {
    const { fps } = current.drawn[0], round = this.frames + HOLD_S * fps;
    // A page that lay in the background goes on where it was; a frame may have begun before its pair was shown.
    const passed = Math.min(Math.max(now - this.since, 0), 250);
    if (!this.paused) this.frame += (passed / 1000) * fps * this.speed;
    this.since = Math.max(now, this.since);
    if (this.frame >= round) { this.frame %= round; this.loops += 1; }
  },
};

function draw() {
  const frame = Math.min(Math.floor(play.frame), play.frames - 1);
  for (const [at, side] of SIDES.entries()) {
    const { image, columns, width, height, pad, frames } = current.drawn[at], cell = Math.min(frame, frames - 1);
    const x = (cell % columns) * (width + 2 * pad) + pad, y = Math.floor(cell / columns) * (height + 2 * pad) + pad;
    side.querySelector("canvas").getContext("2d").drawImage(image, x, y, width, height, 0, 0, width, height);
  }
  $("pair").dataset.frame = frame;
}

function tick(now) {
  if (current) {
    play.advance(now);
    draw();
  }
  requestAnimationFrame(tick);
}

// ---- answers ----

const WORDS = { left: "the left one", right: "the right one", equal: "equal", skip: "cannot tell" };

async function answer(chosen, input) {
  if (!current || busy || feedback) return;
  busy = true;
  document.body.dataset.state = "answered";
  const loops = play.loops + Math.min(play.frame / play.frames, 1);
  const body = { claim: current.claim, chosen, latency_ms: performance.now() - play.shown, loops, speed: play.speed, input };
  mark(chosen);
  const seen = sleep(SEEN_MS);
  try {
    const told = await post("answer", body);
    note = !told.ok ? `Not counted: ${told.message}.` : told.better ? "" : `Your last answer: ${WORDS[chosen]}.`;
    if (told.ok) {
      given.push(body.claim);
      counted = { done: told.done, of: told.of, round: current.round };
      count(told);
      if (told.better) await explain(chosen, told.better);
    }
    await seen;
    busy = false;
    await forward();
  } catch (error) {
    failed(error);
  }
}

async function explain(chosen, better) {
  mark(chosen, better);
  const right = chosen === better;
  tell(right ? `Yes, the ${better} one does it better.` : `Here the ${better} one does it better.`, "feedback");
  $("next").hidden = false;
  await new Promise((done) => (feedback = done));
  feedback = null;
  $("next").hidden = true;
}

async function undo() {
  if (busy || feedback) return;
  busy = true;
  turn += 1; // a pair that was waited for and comes meanwhile may be this very one: it would be shown twice
  try {
    const told = await post("undo", { claim: given.at(-1) ?? null });
    const pair = told.ok && (await loaded(told));
    note = told.ok ? "Undone." : `Not undone: ${told.message}.`;
    if (told.ok) {
      given.pop();
      counted = null;
      if (current) queue.unshift(Promise.resolve(current));
    }
    if (pair.drawn) return present(pair);
    if (current && !told.ok) {
      show();
      return tell(note);
    }
    forward().catch(failed);
  } catch (error) {
    failed(error);
  } finally {
    busy = false;
  }
}

async function forward() {
  const mine = ++turn;
  current = null;
  document.body.dataset.state = "loading";
  const late = setTimeout(() => tell("The next pair is being drawn …"), 400);
  for (let patient = false; ; ) {
    const pair = await (queue.shift() ?? claim([], patient));
    clearTimeout(late);
    if (mine !== turn) return; // an undo came first; the server gives this page what it holds again
    if (given.includes(pair.claim)) continue; // asked for again before its answer had arrived
    if (pair.state === "question") {
      present(pair);
      if (!queue.length) queue.push(claim([pair.claim]));
      queue.at(-1).catch(() => {}); // said when it is wanted
      return;
    }
    if (pair.state === "over") return end();
    patient = pair.state === "wait";
    if (patient) waiting(pair);
    else await sleep(AGAIN_MS);
    if (pair.state === "trouble") { reveal(false); tell(pair.message, "trouble"); }
  }
}

function waiting(told) {
  reveal(false);
  count(told);
  const soon = told.minutes === null ? "" : ` in about ${Math.max(1, Math.round(told.minutes))} min`;
  const when = told.others ? "Others are still answering." : `The next questions come${soon} by themselves.`;
  const open = told.unshown ? ` ${told.unshown} pairs cannot be shown here; whoever started the study was told.` : "";
  const undoable = given.length ? " Z takes your last answer back for a little while." : "";
  const before = told.begun ? "Thank you. The robot is training now." : "The robot is trying things out.";
  tell(`${note.startsWith("Not") ? note : ""} ${before} ${when}${open} You may close this page; a new link brings you back.${undoable}`.trim(), "wait");
}

function end() {
  reveal(false);
  current = null;
  tell("That was all: the study is complete. Thank you! You may close this page.", "over");
}

function failed(error) {
  if (!(error instanceof Gone)) throw error;
  reveal(false);
  current = null;
  tell(`${error.message[0].toUpperCase()}${error.message.slice(1)}.`, "gone");
}

// ---- keys and buttons ----

const ACTIONS = {
  ArrowLeft: () => answer("left", "key"), ArrowUp: () => answer("left", "key"),
  ArrowRight: () => answer("right", "key"), ArrowDown: () => answer("right", "key"),
  " ": () => answer("equal", "key"), s: () => answer("skip", "key"),
  z: undo, Backspace: undo, p: () => play.pause(!play.paused), r: () => play.restart(),
  ",": () => current && play.step(-1), ".": () => current && play.step(1),
  1: () => speed(0), 2: () => speed(1), 3: () => speed(2), "?": () => $("keys").showModal(),
  Enter: () => feedback?.(),
};

function speed(at) {
  document.querySelector(`[name=speed][value="${SPEEDS[at]}"]`).checked = true;
}

addEventListener("keydown", (event) => {
  if (event.repeat || event.ctrlKey || event.altKey || event.metaKey || $("keys").open) return;
  const own = event.target.closest?.("button, input, a");
  if (own && (event.key === " " || event.key === "Enter" || own.matches("input"))) return; // theirs
  const action = ACTIONS[event.key.length === 1 ? event.key.toLowerCase() : event.key];
  if (action) { event.preventDefault(); action(); }
});
addEventListener("click", (event) => {
  const button = event.target.closest("button");
  if (event.detail > 0) document.activeElement?.blur(); // or Space would press it again
  if (button?.dataset.choice) answer(button.dataset.choice, event.detail > 0 ? "pointer" : "key");
});
for (const [id, name] of [["undo", "z"], ["pause", "p"], ["back", ","], ["forth", "."], ["restart", "r"], ["help", "?"], ["next", "Enter"]]) {
  $(id).addEventListener("click", () => ACTIONS[name]());
}
setInterval(async () => {
  if (document.hidden || !current || busy) return;
  const held = (await Promise.all([current, ...queue])).map((pair) => pair.claim).filter(Boolean);
  await post("renew", { held });
}, RENEW_MS);

// ---- the beginning ----

(async () => {
  const link = location.hash.slice(1);
  if (link) {
    history.replaceState(null, "", "/");
    key = null;
    const told = await post("session", { token: link });
    if (!told.ok) throw new Gone(told.message);
    key = told.key;
    sessionStorage.setItem("key", key);
  }
  if (!key) throw new Gone("open the link that `rrmctl label` printed");
  play.pause(play.paused);
  requestAnimationFrame(tick);
  await forward();
})().catch(failed);
