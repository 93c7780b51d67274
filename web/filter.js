// SPDX-License-Identifier: GPL-2.0-or-later
// The field of the display filter: completion, what is wrong with it, and the filters that were used.

const STORE = "yapp.filters";
const MAX_HISTORY = 30;
const MAX_NAMES = 60;

const history = () => { try { return JSON.parse(localStorage.getItem(STORE)) ?? []; } catch { return []; } }; // storage may be forbidden

function remember(filter) {
  const list = [filter, ...history().filter((one) => one !== filter)].slice(0, MAX_HISTORY);
  try { localStorage.setItem(STORE, JSON.stringify(list)); } catch { /* then there is no history */ }
}

export class Filter {
  // field, names (a datalist), error: elements; check: async function(filter) -> what is wrong;
  // complete: async function(beginning) -> [{ filter, name }]; apply: async function(filter)
  constructor(field, names, error, parts) {
    Object.assign(this, { field, names, error, ...parts });
    field.addEventListener("input", () => this.typed());
    field.addEventListener("focus", () => this.typed());
    field.form.addEventListener("submit", (event) => {
      event.preventDefault();
      this.use(field.value);
    });
  }

  async typed() {
    const filter = this.field.value, word = filter.match(/[A-Za-z_][\w.]+$/)?.[0] ?? "";
    const found = word ? (await this.complete(word)).slice(0, MAX_NAMES) : [];
    const problem = await this.check(filter);
    if (filter !== this.field.value) return; // more was typed
    const front = filter.slice(0, filter.length - word.length);
    const options = found.length ? found.map(({ filter: name, name: title }) => new Option(title, front + name))
      : history().map((one) => new Option("used before", one));
    this.names.replaceChildren(...options);
    this.color(filter, problem);
    if (!problem) this.error.textContent = "";
  }

  color(filter, problem) {
    this.field.classList.toggle("good", filter.trim() !== "" && !problem);
    this.field.classList.toggle("bad", problem !== "");
  }

  // Apply a filter, if it is one.
  async use(filter) {
    this.field.value = filter = filter.trim();
    const problem = await this.check(filter);
    this.color(filter, problem);
    this.error.textContent = problem;
    if (problem) return;
    if (filter) remember(filter);
    await this.apply(filter);
  }
}
