// The slider of a recorded run: what is shown is decided by the server, which plays the log; here it is only asked for.

import { $, clock, make, post } from "./dom";
import { icon } from "./icons";
import type { Timeline } from "./state";

const SPEEDS = [0.5, 1, 2, 5, 10, 30, 100];
const STEP = 5; // seconds that an arrow goes; with shift six times as much

export class TimelineBar {
  private readonly play = make("button", { class: "quiet", id: "play", onclick: () => this.toggle() });
  private readonly slider = make("input", { type: "range", id: "time", min: "0", step: "any", "aria-label": "Time in the log" });
  private readonly time = make("span", { class: "time" });
  private readonly speeds = make("select", { id: "speed", "aria-label": "Speed", title: "Speed" });
  private now: Timeline | null = null;
  private wanted: number | null = null; // where the slider was put, until the server is there too
  private asking = false;

  constructor() {
    for (const speed of SPEEDS) this.speeds.append(make("option", { value: String(speed) }, `${speed}×`));
    this.speeds.value = "1";
    this.speeds.addEventListener("change", () => {
      if (this.now?.speed) void post("play", { speed: Number(this.speeds.value) });
    });
    this.slider.addEventListener("input", () => this.seek(this.slider.valueAsNumber));
    $("timeline").append(this.play, this.slider, this.time, this.speeds);
    this.show(false);
  }

  /** Whether anybody is there to be asked. */
  enable(there: boolean): void {
    for (const element of [this.play, this.slider, this.speeds]) element.disabled = !there;
  }

  /** What the server says. */
  update(timeline: Timeline | null): void {
    this.now = timeline;
    $("timeline").hidden = timeline === null;
    if (timeline === null) return;
    if (!this.asking) this.wanted = null;
    this.slider.max = String(timeline.duration);
    if (this.wanted === null) this.slider.valueAsNumber = timeline.seconds;
    this.show(timeline.speed > 0);
    if (timeline.speed > 0 && SPEEDS.includes(timeline.speed) && document.activeElement !== this.speeds) this.speeds.value = String(timeline.speed);
    const reading = timeline.whole ? (timeline.torn ? "; the log is torn off here" : "") : "; reading on";
    this.time.textContent = `${clock(this.wanted ?? timeline.seconds)} / ${clock(timeline.duration)}`;
    this.slider.setAttribute("aria-valuetext", this.time.textContent);
    this.time.title = `seconds since the log began${reading}`;
    $("timeline").classList.toggle("reading", !timeline.whole);
    $("timeline").classList.toggle("torn", timeline.torn !== "");
  }

  toggle(): void {
    void post("play", { speed: this.now?.speed ? 0 : Number(this.speeds.value) });
  }

  /** A key that means something here; gives whether it did. */
  key(event: KeyboardEvent): boolean {
    const button = (event.target as HTMLElement).tagName === "BUTTON";
    if (this.now === null || this.play.disabled || (button && event.key === " ")) return false;
    const step = STEP * (event.shiftKey ? 6 : 1);
    const at = this.wanted ?? this.now.seconds;
    const deeds: Record<string, () => void> = {
      " ": () => this.toggle(),
      ArrowLeft: () => this.seek(at - step),
      ArrowRight: () => this.seek(at + step),
      Home: () => this.seek(0),
      End: () => this.seek(this.now!.duration),
    };
    deeds[event.key]?.();
    return event.key in deeds;
  }

  private seek(seconds: number): void {
    this.wanted = Math.min(Math.max(seconds, 0), this.now?.duration ?? 0);
    this.slider.valueAsNumber = this.wanted;
    if (!this.asking) void this.ask();
  }

  /** One wish at a time; when it is fulfilled, the newest of those that came meanwhile. */
  private async ask(): Promise<void> {
    this.asking = true;
    let asked: number | null;
    let done: boolean;
    do {
      asked = this.wanted;
      done = await post("seek", { seconds: asked });
    } while (done && this.wanted !== asked);
    this.asking = false;
    if (!done) this.wanted = null;
  }

  private show(playing: boolean): void {
    if (this.play.dataset.playing === String(playing)) return;
    this.play.dataset.playing = String(playing);
    this.play.title = playing ? "Pause (space)" : "Play (space)";
    this.play.setAttribute("aria-label", playing ? "Pause" : "Play");
    this.play.replaceChildren(icon(playing ? "pause" : "play"));
  }
}
