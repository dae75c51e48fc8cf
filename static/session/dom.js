// How are elements made and changed? Small functions over the DOM, nothing that remembers anything.

const SVG = "http://www.w3.org/2000/svg";

// An HTML element: `on` holds listeners, `css` custom properties and styles, all else attributes; null leaves one out.
export function h(name, attributes = {}, ...children) {
  return fill(document.createElement(name), attributes, children);
}

// The same for SVG.
export function s(name, attributes = {}, ...children) {
  return fill(document.createElementNS(SVG, name), attributes, children);
}

function fill(element, attributes, children) {
  setAttributes(element, attributes);
  element.append(...children.flat(Number.POSITIVE_INFINITY).filter((child) => child !== null && child !== undefined));
  return element;
}

export function setAttributes(element, attributes) {
  for (const [name, value] of Object.entries(attributes)) {
    if (name === "on") for (const [kind, listener] of Object.entries(value)) element.addEventListener(kind, listener);
    else if (name === "css") for (const [key, text] of Object.entries(value)) element.style.setProperty(key, text);
    else if (value === null || value === undefined || value === false) element.removeAttribute(name);
    else element.setAttribute(name, value === true ? "" : value);
  }
  return element;
}

// Change a text only where it is another: screen readers would read it again.
export function setText(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

// Put nodes and texts in place of what an element holds, only where they are others: what is under the mouse stays.
export function setContent(element, ...children) {
  const wanted = element.cloneNode(false);
  wanted.append(...children.flat());
  if (!wanted.isEqualNode(element)) element.replaceChildren(...wanted.childNodes);
}

export const byId = (id) => document.getElementById(id);

// A copy of the element in a <template> of the page.
export const copyOf = (id) => byId(id).content.firstElementChild.cloneNode(true);

// Show a sentence in an element that is only there while it says something; takes the element's id.
export const sentence = (id) => (text) => {
  setText(byId(id), text);
  byId(id).hidden = !text;
};

// Show a sentence in the place of what an element holds.
export const insteadOf = (id) => (text) => text && byId(id).replaceChildren(h("p", { class: "calm" }, text));

// A name that may be too long for its place: whole under the mouse.
export function setName(element, name) {
  setText(element, name);
  element.title = name;
}

// Copies of `template` for `items`, by their keys: the same elements while number and contents change, so that focus and
// scroll stay. `show` fills one in.
export function reconcile(place, template, items, key, show) {
  const old = new Map([...place.children].map((child) => [child.dataset.key, child]));
  items.forEach((item, at) => {
    const name = String(key(item, at));
    const child = old.get(name) ?? copyOf(template);
    old.delete(name);
    child.dataset.key = name;
    show(child, item, at);
    if (place.children[at] !== child) place.insertBefore(child, place.children[at] ?? null);
  });
  for (const child of old.values()) child.remove();
}

// A button that says what it does.
export function button(text, press, attributes = {}) {
  return h("button", { type: "button", ...attributes, on: { click: press } }, text);
}

// A few choices side by side, of which one holds. Returns the element and a function that shows the value.
export function segments(label, values, choose, text = String) {
  const buttons = values.map((value) =>
    button(text(value), () => choose(value), { class: "segment", "data-value": value, "aria-pressed": "false" }),
  );
  const element = h("div", { class: "segments", role: "group", "aria-label": label }, buttons);
  const show = (value) => {
    for (const one of buttons) one.setAttribute("aria-pressed", String(one.dataset.value === String(value)));
  };
  return [element, show];
}
