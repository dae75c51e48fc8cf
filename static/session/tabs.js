// Which of the side panel's pages is open? Tabs as assistive technology knows them: arrows move, one is in the tab order.

import { state, update } from "./state.js";

const tabs = () => [...document.querySelectorAll("[role=tab]")];

export function install(first) {
  for (const tab of tabs()) {
    tab.addEventListener("click", () => open(tab.dataset.tab));
    tab.addEventListener("keydown", (event) => {
      const all = tabs();
      const by = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
      const next = by
        ? all[(all.indexOf(tab) + by + all.length) % all.length]
        : { Home: all[0], End: all.at(-1) }[event.key];
      if (!next) return;
      event.preventDefault();
      open(next.dataset.tab);
      next.focus();
    });
  }
  open(tabs().some((tab) => tab.dataset.tab === first) ? first : state.tab);
}

export function open(name) {
  for (const tab of tabs()) {
    const chosen = tab.dataset.tab === name;
    tab.setAttribute("aria-selected", String(chosen));
    tab.tabIndex = chosen ? 0 : -1;
    document.getElementById(tab.getAttribute("aria-controls")).hidden = !chosen;
  }
  update({ tab: name });
}
