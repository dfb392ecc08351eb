// The socket: frames in, nothing out. Whoever is at this page's address is followed; a connection that is lost, or an
// observer that has ended, is tried again and again, and until then the last map stays.

import { decode } from "@msgpack/msgpack";
import type { Frame } from "./state";

export type Standing = "connecting" | "live" | "lost" | "ended";

const SILENCE = 8000; // milliseconds; a server that is there says something every two seconds
const WAITS = { first: 500, most: 5000 };

export function follow(take: (frame: Frame) => void, tell: (standing: Standing) => void, begin: () => void): void {
  let wait = WAITS.first;
  let ended = false;
  const open = (): void => {
    const socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/live`);
    socket.binaryType = "arraybuffer";
    let heard = false;
    let watchdog: ReturnType<typeof setTimeout>;
    const watch = (): void => {
      clearTimeout(watchdog);
      watchdog = setTimeout(() => socket.close(), SILENCE);
    };
    watch();
    socket.onmessage = (event: MessageEvent<ArrayBuffer>) => {
      watch();
      if (!heard) {
        heard = true;
        ended = false;
        wait = WAITS.first;
        begin(); // the server sends everything anew
        tell("live");
      }
      const frame = decode(new Uint8Array(event.data)) as Frame;
      take(frame);
      if (frame.ended) {
        ended = true;
        tell("ended");
      }
    };
    socket.onclose = () => {
      clearTimeout(watchdog);
      if (!ended) tell("lost");
      setTimeout(open, wait);
      wait = Math.min(2 * wait, WAITS.most);
    };
  };
  tell("connecting");
  open();
}

/** Numbers of an array that may lie anywhere in a frame. */
export function int16(bytes: Uint8Array): Int16Array {
  return new Int16Array(bytes.slice().buffer);
}

export function int32(bytes: Uint8Array): Int32Array {
  return new Int32Array(bytes.slice().buffer);
}
