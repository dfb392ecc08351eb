// The socket: frames in, nothing out. A connection that is lost is tried again; a swarm that has ended is not.

import { decode } from "@msgpack/msgpack";
import type { Frame } from "./state";

export type Standing = "connecting" | "live" | "lost" | "ended";

export function follow(take: (frame: Frame) => void, tell: (standing: Standing) => void, begin: () => void): void {
  let ended = false;
  let wait = 500;
  const open = (): void => {
    const socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/live`);
    socket.binaryType = "arraybuffer";
    let first = true;
    socket.onmessage = (event: MessageEvent<ArrayBuffer>) => {
      if (first) {
        begin(); // the server sends everything anew
        tell("live");
        wait = 500;
        first = false;
      }
      const frame = decode(new Uint8Array(event.data)) as Frame;
      take(frame);
      if (frame.ended) {
        ended = true;
        tell("ended");
      }
    };
    socket.onclose = () => {
      if (ended) return;
      tell("lost");
      setTimeout(open, wait);
      wait = Math.min(2 * wait, 5000);
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
