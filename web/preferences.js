// SPDX-License-Identifier: GPL-2.0-or-later
// The plugin's preferences, as Wireshark has them, and the user's own messages.
import { make } from "./dom.js";

const FIRST = ["sources", "late", "all_extended", "hide_source"]; // in front of the others

// The lines of Wireshark's file that set preferences; changed: { "yapp.sources": "..." }.
export function linesOf(changed) {
  return Object.entries(changed).map(([name, value]) => `${name}: ${value.replace(/[\r\n]+/g, " ")}\n`).join("");
}

function input({ value, isSwitch, choices }) {
  if (choices.length) {
    return make("select", {}, ...choices.map((one) => new Option(one.description, one.name, false, one.selected)));
  }
  return make("input", isSwitch ? { type: "checkbox", checked: value === "TRUE" } : { value, size: 40, spellcheck: false });
}

const valueOf = (element) => element.type === "checkbox" ? String(element.checked).toUpperCase() : element.value;

export class Preferences {
  // dialog: element; apply: function(changed, file with messages or nothing)
  constructor(dialog, apply) {
    this.dialog = dialog;
    this.rows = dialog.querySelector("[data-part=rows]");
    this.file = dialog.querySelector("[type=file]");
    dialog.addEventListener("close", () => {
      if (dialog.returnValue !== "apply") return;
      const changed = {};
      for (const [name, { element, before }] of this.inputs) {
        if (valueOf(element) !== before) changed[`yapp.${name}`] = valueOf(element);
      }
      apply(changed, this.file.files[0]);
    });
  }

  // preferences: of Engine.preferences
  open(preferences) {
    this.inputs = new Map();
    const place = ({ name }) => FIRST.includes(name) ? FIRST.indexOf(name) : FIRST.length;
    const shown = preferences.filter(({ name }) => name !== "messages").sort((a, b) => place(a) - place(b));
    this.rows.replaceChildren(...shown.map((one) => {
      const element = input(one);
      this.inputs.set(one.name, { element, before: valueOf(element) });
      return make("label", {}, one.title, element, make("small", {}, one.description));
    }));
    this.file.value = "";
    this.dialog.returnValue = "";
    this.dialog.showModal();
  }
}
