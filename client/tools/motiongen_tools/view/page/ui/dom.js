// Small elements: made by name, properties and children.

/** make("button", {title: "Add", onclick: act}, "Add") */
export function make(name, properties = {}, ...children) {
  const element = document.createElement(name);
  for (const [key, value] of Object.entries(properties)) {
    if (key === "dataset") Object.assign(element.dataset, value);
    else if (key.startsWith("aria-") || key === "role" || key === "list") element.setAttribute(key, value);
    else element[key] = value;
  }
  element.append(...children.filter((child) => child !== null && child !== undefined));
  return element;
}

/**
 * Have a list show entries, each as [key, make()]; where the key is the same, so is what is shown. An entry that is there
 * already stays the same element, with the focus and the pointer that are on it.
 */
export function list(element, entries) {
  const keys = new Set(entries.map(([key]) => key));
  const there = new Map();
  for (const child of [...element.children]) {
    if (keys.has(child.dataset.key)) there.set(child.dataset.key, child);
    else child.remove();
  }
  let at = element.firstElementChild;
  for (const [key, makeOne] of entries) {
    const child = there.get(key) ?? makeOne();
    child.dataset.key = key;
    if (child === at) at = at.nextElementSibling;
    else element.insertBefore(child, at);
  }
}

/** A label around an input, with its name before it. */
export function labelled(name, input) {
  return make("label", {}, make("span", {}, name), input);
}

const NOTE_MS = 6000;
const MOST_NOTES = 4;

/** Show a message to the user; kind: "info" or "error". */
export function note(text, kind = "info") {
  const notes = document.getElementById("notes");
  const line = make("p", { className: kind }, text);
  notes.append(line);
  while (notes.children.length > MOST_NOTES) notes.firstChild.remove();
  setTimeout(() => line.remove(), NOTE_MS);
}

/** Do something that may fail, and show the error if it does. */
export async function trying(act) {
  try {
    return await act();
  } catch (error) {
    note(error.message, "error");
    return null;
  }
}
