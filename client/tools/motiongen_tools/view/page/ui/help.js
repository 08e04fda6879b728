// The overview of keys.
import { make } from "./dom.js";

const KEYS = [
  ["W A S D, arrows", "walk, as the camera sees it; Shift runs, Alt faces where the camera looks"],
  ["gamepad", "left stick walks, first button runs"],
  ["1 to 5", "tools: walk, path, hand or foot, face, pose"],
  ["/", "to the prompt"], ["Tab", "to the next control"], ["n, p", "next and previous character"],
  ["Space", "pause, go on"], ["u", "undo"], ["f", "the camera follows, or does not"], ["v", "look at the chosen one"],
  ["c", "compare two takes"], ["t", "trails and contacts"], ["l", "light or dark"], ["b", "only the stage"], ["?", "this"],
];

export function makeHelp(dialog) {
  const table = make("table", {}, ...KEYS.map(([key, does]) => make("tr", {}, make("th", { scope: "row" }, key), make("td", {}, does))));
  dialog.append(make("h2", {}, "Keys"), table, make("form", { method: "dialog" }, make("button", {}, "Close")));
}
