// The panel: the swarm in a few facts, its robots with their state and why, who else is there.

import { $, bytes, clock, confirmed, dot, make, post, seconds } from "./dom";
import type { Session, State } from "./state";
import type { Store } from "./store";

export interface Deeds {
  jump(session: string): void;
  toggle(session: string): void;
  place(session: Session): void;
  shown: Set<string>;
}

export class Panel {
  private readonly open = new Set<string>();
  private readonly cards = new Map<string, Card>();
  private readonly chips = make("p", { class: "chips" });
  private readonly replaced = make("details", {}, make("summary"), make("div")); // stays the same, for it may be open

  constructor(
    private readonly store: Store,
    private readonly deeds: Deeds,
  ) {
    $("peers").append(
      make("h2", {}, "Peers that this observer hears"),
      this.chips,
      make("p", { class: "dim" }, "✓ said that it holds this very map. Who hears whom besides is not told on the wire."),
      this.replaced,
    );
  }

  /** Show a robot's details, for instance because it was clicked on the map. */
  reveal(session: string): void {
    this.open.add(session);
    this.update();
    this.cards.get(session)?.element.scrollIntoView({ block: "nearest" });
  }

  update(): void {
    const state = this.store.state;
    if (!state) return;
    $("swarm").textContent = state.swarm;
    document.title = `${state.swarm} - Orion swarm`;
    this.facts(state);
    this.robots(state);
    this.peers(state);
  }

  private facts(state: State): void {
    const same = state.peers.filter((peer) => peer.same).length;
    const mark = state.timeline
      ? make("span", { class: "mark" }, `at ${clock(state.timeline.seconds)}`)
      : state.agree
      ? make("span", { class: "mark good", title: "Every peer that is there said that it holds this very map." }, "✓ all agree")
      : make(
          "span",
          { class: "mark", title: "How many of the peers that are there last said that they hold this very map. Robots that map say so only now and then." },
          state.peers.length === 0 ? "nobody else is there" : `${same} of ${state.peers.length} agree`,
        );
    $("facts").replaceChildren(
      fact(`${state.known_m2.toFixed(2)} m²`, "known"),
      fact(String(state.tiles), "tiles"),
      fact(bytes(state.bytes_rate), state.timeline ? "of updates" : state.budget ? `of ${bytes(state.budget)}` : "heard"),
      make(
        "div",
        { class: "fact wide" },
        make("code", { id: "digest", title: "The map's digest: whoever has the same has the same map, bit for bit." }, state.digest ? `${state.digest.slice(0, 8)} ${state.digest.slice(8, 16)} …` : "…"),
        mark,
      ),
    );
    $("digest").dataset.digest = state.digest;
  }

  private robots(state: State): void {
    const held = state.sessions.filter((each) => !each.replaced);
    const ids = new Set(held.map((each) => each.session));
    for (const [session, card] of this.cards) {
      if (ids.has(session)) continue;
      card.element.remove();
      this.cards.delete(session);
    }
    const names = new Map<string, number>();
    for (const session of held) names.set(session.robot, (names.get(session.robot) ?? 0) + 1);
    for (const session of held) {
      let card = this.cards.get(session.session);
      if (!card) this.cards.set(session.session, (card = new Card(session.session, this.deeds, this.open, () => this.update())));
      card.update(session, (names.get(session.robot) ?? 0) > 1, state);
    }
    const list = $("robots");
    held.forEach((session, k) => {
      const element = this.cards.get(session.session)!.element;
      if (list.children[k] !== element) list.insertBefore(element, list.children[k] ?? null);
    });
    if (held.length === 0 && list.children.length === 0) list.append(make("li", { class: "dim empty" }, "Nobody has been heard yet."));
    else if (held.length > 0) list.querySelector(".empty")?.remove();
  }

  private peers(state: State): void {
    const replaced = state.sessions.filter((each) => each.replaced);
    this.chips.replaceChildren(
      ...state.peers.map((peer) =>
        make("span", { class: "chip", title: peer.same === null ? "It has not said yet what it holds." : peer.same ? "It said that it holds this very map." : "It last said that it holds another state." }, `${peer.same ? "✓" : "·"} ${peer.name}`),
      ),
      state.peers.length === 0 ? "No other peer is there." : "",
    );
    this.replaced.hidden = replaced.length === 0;
    this.replaced.querySelector("summary")!.textContent = `${replaced.length} replaced session${replaced.length > 1 ? "s" : ""}`;
    this.replaced.querySelector("div")!.replaceChildren(...replaced.map((each) => make("p", { class: "dim" }, `${each.robot} ${each.session.slice(0, 6)}: ${each.reason}`)));
  }
}

function fact(value: string, name: string): HTMLElement {
  return make("div", { class: "fact" }, make("b", {}, value), make("span", {}, name));
}

/** One robot's session. Elements that a hand may be on stay the same from one update to the next. */
class Card {
  readonly element: HTMLElement;
  private readonly name = make("button", { class: "name" });
  private readonly layer = make("button", { class: "quiet layer", "aria-pressed": "false", title: "Its own map over the others'" }, "layer");
  private readonly line = make("p", { class: "state" });
  private readonly more = make("div", { class: "more" });
  private readonly numbers = make("dl");
  private readonly evict = make("button", { class: "evict" });
  private readonly place = make("button", { class: "place" }, "Correct its start...");
  private session!: Session;

  constructor(
    id: string,
    private readonly deeds: Deeds,
    private readonly open: Set<string>,
    update: () => void,
  ) {
    this.name.addEventListener("click", () => {
      if (open.has(id)) open.delete(id);
      else open.add(id);
      update();
    });
    this.name.addEventListener("dblclick", () => deeds.jump(id));
    this.layer.addEventListener("click", () => deeds.toggle(id));
    this.place.addEventListener("click", () => deeds.place(this.session));
    this.evict.addEventListener("click", () => void this.decide());
    this.more.append(
      this.numbers,
      make("div", { class: "row" }, make("button", { onclick: () => deeds.jump(id) }, "Jump to it"), this.place, this.evict),
    );
    this.element = make("li", { class: "robot-card", "data-session": id }, make("div", { class: "head" }, this.name, this.layer), this.line, this.more);
  }

  update(session: Session, ambiguous: boolean, state: State): void {
    this.session = session;
    this.name.replaceChildren(dot(session.colour), session.robot, ambiguous ? make("small", {}, ` ${session.session.slice(0, 6)}`) : "");
    this.layer.setAttribute("aria-label", `${session.robot}'s own map`);
    this.layer.setAttribute("aria-pressed", String(this.deeds.shown.has(session.session)));
    const standing = session.reason || (session.summed ? (session.live || state.timeline ? "in the map" : "in the map; its writer is away") : "not in the map");
    const trouble = !session.summed || session.reason !== "";
    this.line.replaceChildren(
      make("span", { class: trouble ? (session.summed ? "badge warn" : "badge bad") : session.live || state.timeline ? "badge good" : "badge" }, trouble ? (session.summed ? "!" : "×") : session.live || state.timeline ? "●" : "○"),
      ` ${standing}`,
      make("span", { class: "rates" }, state.timeline ? `${session.updates_rate.toFixed(1)}/s` : session.bytes_rate === null ? "away" : `${session.updates_rate.toFixed(1)}/s · ${bytes(session.bytes_rate)}`),
    );
    const open = this.open.has(session.session);
    this.element.classList.toggle("open", open);
    this.name.setAttribute("aria-expanded", String(open));
    if (open) {
      const share = state.budget && session.bytes_rate !== null ? ` (${Math.round((100 * session.bytes_rate) / state.budget)} % of the radio's)` : "";
      this.numbers.replaceChildren(
        ...[
          ["session", session.session],
          ["updates", session.known_n > session.n ? `${session.n} of ${session.known_n}` : String(session.n)],
          ["heard", session.age === null ? "never" : seconds(session.age) === "now" ? "now" : `${seconds(session.age)} ago`],
          ["traffic", session.bytes_rate === null ? "away" : bytes(session.bytes_rate) + share],
          ["tiles", String(session.tiles)],
        ].flatMap(([name, value]) => [make("dt", {}, name), make("dd", {}, value)]),
      );
    }
    this.evict.hidden = this.place.hidden = state.timeline !== null; // there is no swarm that could follow
    this.evict.textContent = session.evicted ? "Readmit..." : "Evict...";
    this.evict.disabled = state.ended;
    this.place.disabled = state.ended || session.tiles === 0;
  }

  private async decide(): Promise<void> {
    const { robot, session, evicted } = this.session;
    const short = session.slice(0, 6);
    const yes = evicted
      ? await confirmed(`Readmit ${robot}?`, [`Session ${short} comes back into everybody's map, exactly as it was.`], "Readmit it")
      : await confirmed(`Evict ${robot}?`, [`Session ${short} leaves everybody's map, exactly, until somebody readmits it. Nothing is lost.`], "Evict it", true);
    if (yes) await post(evicted ? "readmit" : "evict", { session });
  }
}
