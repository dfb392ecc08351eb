// Small helpers: elements are made, never parsed, so nothing that a peer says is ever markup.

type Child = Node | string | null | undefined | false;

export function $<E extends HTMLElement = HTMLElement>(id: string): E {
  return document.getElementById(id) as E;
}

export function make<K extends keyof HTMLElementTagNameMap>(
  tag: K,
  attributes: Record<string, string | boolean | ((event: Event) => void)> = {},
  ...children: Child[]
): HTMLElementTagNameMap[K] {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (typeof value === "function") element.addEventListener(name.slice(2), value);
    else if (value === true) element.setAttribute(name, "");
    else if (value !== false) element.setAttribute(name, value);
  }
  for (const child of children) if (child) element.append(child);
  return element;
}

export function dot(colour: string, title = ""): HTMLElement {
  const element = make("span", { class: "dot", title });
  element.style.setProperty("--colour", colour);
  return element;
}

export function bytes(rate: number): string {
  return rate < 1000 ? `${Math.round(rate)} B/s` : rate < 1e6 ? `${(rate / 1000).toFixed(1)} kB/s` : `${(rate / 1e6).toFixed(1)} MB/s`;
}

export function seconds(age: number): string {
  return age < 2 ? "now" : age < 120 ? `${Math.round(age)} s` : age < 7200 ? `${Math.round(age / 60)} min` : `${Math.round(age / 3600)} h`;
}

/** Seconds as m:ss, or h:mm:ss. */
export function clock(time: number): string {
  const whole = Math.floor(time);
  const [hours, minutes] = [Math.floor(whole / 3600), Math.floor(whole / 60) % 60];
  const rest = String(whole % 60).padStart(2, "0");
  return hours ? `${hours}:${String(minutes).padStart(2, "0")}:${rest}` : `${minutes}:${rest}`;
}

/** Ask before something is done; gives whether it shall be. */
export function confirmed(title: string, lines: string[], action: string, danger = false): Promise<boolean> {
  const dialog = $<HTMLDialogElement>("dialog");
  return new Promise((resolve) => {
    const answer = (yes: boolean): void => {
      dialog.onclose = null;
      dialog.close();
      resolve(yes);
    };
    dialog.setAttribute("aria-label", title);
    dialog.replaceChildren(
      make("h2", {}, title),
      ...lines.map((line) => make("p", {}, line)),
      make(
        "div",
        { class: "row end" },
        make("button", { onclick: () => answer(false) }, "Cancel"),
        make("button", { class: danger ? "primary danger" : "primary", id: "confirm", onclick: () => answer(true) }, action),
      ),
    );
    dialog.onclose = () => answer(false);
    dialog.showModal();
  });
}

export function told(title: string, ...children: Child[]): void {
  const dialog = $<HTMLDialogElement>("dialog");
  dialog.onclose = null;
  dialog.setAttribute("aria-label", title);
  dialog.replaceChildren(
    make("h2", {}, title),
    ...children.filter((child): child is Node | string => Boolean(child)),
    make("div", { class: "row end" }, make("button", { class: "primary", onclick: () => dialog.close() }, "Close")),
  );
  if (!dialog.open) dialog.showModal();
}

/** Ask the server for something; what is wrong with it is told. Gives whether it was done. */
export async function post(what: string, fields: object): Promise<boolean> {
  let why: string;
  try {
    const response = await fetch(`api/${what}`, {
      method: "POST",
      headers: { "content-type": "application/json" },
      body: JSON.stringify(fields),
    });
    if (response.ok) return true;
    why = ((await response.json()) as { error: string }).error;
  } catch {
    why = "The observer cannot be reached.";
  }
  told("That was not done", make("p", {}, why));
  return false;
}

/** Do something at most once in so many milliseconds: at once if it was long ago, else when they are over. */
export function seldom(wait: number, deed: () => void): () => void {
  let free = 0;
  let due = false;
  return () => {
    if (due) return;
    const left = free - performance.now();
    const now = (): void => {
      due = false;
      free = performance.now() + wait;
      deed();
    };
    if (left <= 0) now();
    else {
      due = true;
      setTimeout(now, left);
    }
  };
}
