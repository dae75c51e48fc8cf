// The controls above the list: what is written or chosen here goes into the address, and the list follows it.

import { byId, h, reconcile, setText } from "../session/dom.js";
import { filters, query, readAddress, STATES, tagCounts, VERDICTS, writeAddress } from "./query.js";

const CHOICES = { verdict: VERDICTS, state: STATES };
let follow;

// `changed` is called whenever another list is wanted.
export function install(changed) {
  follow = changed;
  for (const [name, words] of Object.entries(CHOICES)) {
    const options = Object.entries(words).map(([value, word]) => h("option", { value }, word));
    byId(`of-${name}`).append(...options);
    byId(`of-${name}`).addEventListener("change", ({ target }) => choose({ [name]: target.value }));
  }
  byId("sort").addEventListener("change", ({ target }) => choose({ sort: target.value }));
  byId("q").addEventListener("input", ({ target }) => choose({ q: target.value }, false));
  byId("all").addEventListener("click", () => {
    choose({ q: "", verdict: "", state: "", tags: [] });
    byId("q").focus();
  });
  window.addEventListener("popstate", back);
  back();
}

function back() {
  readAddress();
  byId("q").value = query.q;
  for (const name of Object.keys(CHOICES)) byId(`of-${name}`).value = query[name];
  byId("sort").value = query.sort;
  follow();
}

function choose(members, step = true) {
  Object.assign(query, members);
  writeAddress(step);
  back();
}

export function toggleTag(tag) {
  choose({ tags: query.tags.includes(tag) ? query.tags.filter((one) => one !== tag) : [...query.tags, tag] });
}

// `shown` of all `sessions` fit.
export function showToolbar(sessions, shown) {
  byId("toolbar").hidden = sessions.length < 2 && !filters();
  byId("nothing").hidden = shown.length > 0 || !sessions.length;
  const known = tagCounts(sessions);
  // one that is asked for and that no session has can be let go of, too
  const missing = query.tags.filter((tag) => !known.some(([name]) => name === tag)).map((tag) => [tag, 0]);
  byId("tags").hidden = !known.length && !missing.length;
  reconcile(
    byId("tags"),
    "tag-filter",
    [...known, ...missing],
    ([tag]) => tag,
    (button, [tag, number]) => {
      setText(button.firstElementChild, tag);
      setText(button.lastElementChild, String(number));
      button.setAttribute("aria-pressed", String(query.tags.includes(tag)));
      button.onclick = () => toggleTag(tag);
    },
  );
  reconcile(
    byId("known-tags"),
    "known-tag",
    known,
    ([tag]) => tag,
    (option, [tag]) => {
      option.value = tag;
    },
  );
}
