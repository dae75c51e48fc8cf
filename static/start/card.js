// One session in the list: its picture, what is found, its name and tags, which can be changed where they stand.

import { call, sessionPath } from "../session/api.js";
import { byId, reconcile, setText } from "../session/dom.js";
import { methodWord, stateWord } from "../session/format.js";
import { wasSeen } from "../session/seen.js";
import { edit } from "./edit.js";
import { grouped, when } from "./format.js";
import { query, verdictWord } from "./query.js";
import { toggleTag } from "./toolbar.js";

const LATER = 5000; // milliseconds to the next try for a picture
const NEAR = "400px"; // cards so far below the window get their pictures, too

export const title = (session) => session.name || "damaged session";

// Hundreds of pictures that nobody sees would keep the server from those that somebody does.
const sight = new IntersectionObserver(
  (entries) => {
    for (const { target, isIntersecting } of entries) {
      target.near = isIntersecting;
      if (isIntersecting) picture(target);
    }
  },
  { rootMargin: NEAR },
);

// `follow` : to be called after a change
export function fillCard(card, session, follow) {
  const part = (name) => card.querySelector(`.${name}`);
  if (!card.session) sight.observe(card);
  // most have not changed since they were asked for last
  const told = JSON.stringify([session, query.tags]);
  if (card.told === told) return;
  Object.assign(card, { told, session });
  card.dataset.state = session.state;
  part("open").href = wasSeen(session.id) ? session.view_url : `${session.view_url}?play`;
  setText(part("name"), title(session));
  setText(part("word"), stateWord(session));
  const done = session.state === "paused" && session.converged; // before all that were asked for
  const total = (done ? session.iteration : session.iterations) ?? 0;
  const iteration = session.iteration === null ? "none" : grouped(session.iteration);
  setText(part("iteration"), total && !done ? `${iteration} of ${grouped(total)}` : iteration);
  const share = total ? Math.min(1, (session.iteration ?? 0) / total) : 0;
  part("track").firstElementChild.style.width = `${100 * share}%`;
  part("certain").dataset.certain = Boolean(session.certain);
  part("certain").dataset.fit = session.fit ?? "";
  part("certain").title = session.fit_reason ?? "";
  setText(part("certain"), verdictWord(session));
  setText(part("method"), methodWord(session.method));
  setText(part("made"), when(session.created));
  part("error").hidden = !session.error;
  setText(part("error"), session.error ?? "");
  part("delete").setAttribute("aria-label", `Delete the session ${title(session)}`);
  part("choose").firstElementChild.setAttribute("aria-label", `Select the session ${title(session)}`);
  part("choose").firstElementChild.value = session.id;
  part("rename").setAttribute("aria-label", `Name and tags of the session ${title(session)}`);
  part("rename").onclick = () => {
    const named = { name: title(session), tags: session.tags };
    edit(card, part("open"), part("rename"), named, async (changes) => {
      await call(sessionPath(session.id), { method: "PATCH", body: changes });
      follow();
    });
  };
  reconcile(part("card-tags"), "tag", session.tags, String, (button, tag) => {
    setText(button, tag);
    button.setAttribute("aria-label", `Only sessions with the tag ${tag}`);
    button.setAttribute("aria-pressed", String(query.tags.includes(tag)));
    button.onclick = () => toggleTag(tag);
  });
  if (card.near) picture(card);
}

// The next picture is loaded beside the one that is shown, one at a time, so that nothing flickers or piles up.
function picture(card) {
  const session = card.session;
  const shown = `${session.id}@${session.iteration}`;
  if (card.loading || card.dataset.picture === shown || session.iteration == null) return;
  card.loading = true;
  const next = new Image();
  next.alt = `The estimate of ${title(session)}, drawn over its scan`;
  next.onload = () => {
    card.querySelector("img").replaceWith(next);
    card.dataset.picture = shown;
    card.loading = false;
  };
  next.onerror = () =>
    setTimeout(() => {
      card.loading = false;
    }, LATER);
  next.src = `/api/v1/sessions/${session.id}/estimate.png?width=640&iteration=${session.iteration}`;
}

// Where the list was put in another order, the element that had the keyboard's focus may have lost it by being moved.
export function keepingFocus(show) {
  const focused = document.activeElement;
  show();
  if (focused !== document.activeElement && byId("sessions").contains(focused)) focused.focus({ preventScroll: true });
}
