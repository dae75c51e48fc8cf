// Is it really to be deleted? A dialog of the browser's own, so that Escape and the keyboard's focus do as they should.

import { byId, setText } from "../session/dom.js";

// Whether the reader said yes. Focus is on "Keep", and goes back to where it was.
export function confirmed(title, text) {
  const dialog = byId("confirm");
  setText(byId("confirm-title"), title);
  setText(byId("confirm-text"), text);
  dialog.returnValue = "";
  dialog.showModal();
  return new Promise((answer) => {
    dialog.addEventListener("close", () => answer(dialog.returnValue === "yes"), { once: true });
  });
}

export function trouble(place, text) {
  setText(place, text);
  place.hidden = !text;
}
