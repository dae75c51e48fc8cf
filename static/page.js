// The list of sessions: asks /api/v1/sessions again and again while somebody looks, and shows what it answers.

const EVERY = 1500; // milliseconds between two questions; the picture's own pace is what a session's iterations give
const LATER = 5000; // after an answer that failed
const WORDS = { running: "iterating", waiting: "waiting for a free place", paused: "paused", failed: "stopped by an error" };

const list = document.getElementById("sessions");
const template = document.getElementById("card").content;
const cards = new Map();

for (const place of document.querySelectorAll(".here")) place.textContent = location.origin;
document.addEventListener("visibilitychange", () => document.hidden || ask());

let timer;
ask();

async function ask() {
  clearTimeout(timer);
  let pause = EVERY;
  try {
    const response = await fetch("/api/v1/sessions", { headers: { Accept: "application/json" } });
    const answer = await response.json();
    if (!response.ok) throw new Error(answer.detail);
    show(answer);
    trouble("");
  } catch (error) {
    trouble(error instanceof TypeError ? "The server does not answer; this page tries again." : error.message);
    pause = LATER;
  }
  if (!document.hidden) timer = setTimeout(ask, pause);
}

function trouble(text) {
  const place = document.getElementById("trouble");
  if (place.textContent !== text) place.textContent = text;
  place.hidden = !text;
}

function show(sessions) {
  const newest = [...sessions].sort((a, b) => (a.created < b.created ? 1 : -1));
  const ids = new Set(newest.map((session) => session.id));
  for (const [id, card] of cards) {
    if (!ids.has(id)) {
      card.remove();
      cards.delete(id);
    }
  }
  newest.forEach((session, place) => {
    if (!cards.has(session.id)) cards.set(session.id, template.cloneNode(true).firstElementChild);
    const card = cards.get(session.id);
    fill(card, session);
    if (list.children[place] !== card) list.insertBefore(card, list.children[place] ?? null);
  });
  document.getElementById("empty").hidden = newest.length > 0;
  say(document.getElementById("summary"), summary(newest));
}

function summary(sessions) {
  if (!sessions.length) return "";
  const running = sessions.filter((session) => session.state === "running").length;
  return `${sessions.length === 1 ? "one" : sessions.length} kept, ${running || "none"} iterating`;
}

function fill(card, session) {
  const part = (name) => card.querySelector("." + name);
  card.dataset.state = session.state;
  part("open").href = session.view_url ?? `/sessions/${session.id}/view/`;
  say(part("name"), session.name || session.id);
  say(part("word"), state(session));
  const done = session.state === "paused" && session.converged; // before all that were asked for
  const total = (done ? session.iteration : session.iterations) ?? 0;
  say(part("iteration"), total && !done ? `${session.iteration} of ${total}` : `${session.iteration ?? "none"}`);
  part("track").firstElementChild.style.width = `${Math.min(100, total ? (100 * session.iteration) / total : 0)}%`;
  part("certain").dataset.certain = Boolean(session.certain);
  say(part("certain"), session.certain ? "certain" : session.converged ? "at rest, not certain" : "not certain yet");
  say(part("method"), session.method === "particle_filter" ? "particle filter" : "belief propagation");
  part("error").hidden = !session.error;
  say(part("error"), session.error ?? "");
  picture(card, session);
}

function state(session) {
  if (session.state === "waiting" && session.position) return `waiting, number ${session.position} in line`;
  if (session.state === "paused" && session.converged) return "done";
  return WORDS[session.state] ?? session.state;
}

// The next picture is loaded beside the one that is shown, one at a time, so that nothing flickers or piles up.
function picture(card, session) {
  const shown = `${session.id}@${session.iteration}`;
  if (card.loading || card.dataset.picture === shown || session.iteration == null) return;
  card.loading = true;
  const next = new Image();
  next.alt = `The estimate of ${session.name || "this session"}, drawn over its scan`;
  next.onload = () => {
    card.querySelector("img").replaceWith(next);
    card.dataset.picture = shown;
    card.loading = false;
  };
  next.onerror = () => setTimeout(() => (card.loading = false), LATER);
  next.src = `/api/v1/sessions/${session.id}/estimate.png?width=640&iteration=${session.iteration}`;
}

function say(place, text) {
  if (place.textContent !== text) place.textContent = text;
}
