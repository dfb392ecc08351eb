// What the server says, as agent/page_feed.py makes it.

export type Pose = [x_mm: number, y_mm: number, yaw_turn16: number];

export interface Session {
  session: string;
  robot: string;
  colour: string;
  n: number;
  known_n: number;
  summed: boolean;
  live: boolean;
  reason: string;
  replaced: boolean;
  evicted: boolean;
  age: number | null;
  updates_rate: number;
  bytes_rate: number | null;
  tiles: number;
  pose: Pose | null;
  sensed_from: Pose | null;
  start: Pose | null;
}

export interface PeerInfo {
  name: string;
  robot: boolean;
  same: boolean | null;
}

/** Where in a log one is. */
export interface Timeline {
  seconds: number;
  duration: number;
  whole: boolean;
  torn: string;
  speed: number;
}

export interface State {
  swarm: string;
  cell_mm: number;
  clear_hit: number;
  digest: string;
  agree: boolean;
  tiles: number;
  known_m2: number;
  bytes_rate: number;
  budget: number | null;
  ended: boolean;
  timeline: Timeline | null;
  peers: PeerInfo[];
  sessions: Session[];
}

export interface Frame {
  state?: State;
  tiles?: [layer: string, level: number, keys: Uint8Array, cells: Uint8Array][];
  tracks?: [layer: string, first: number, trail: Uint8Array, firstHit: number, hits: Uint8Array][];
  history?: [seconds: number, known_m2: number, bytes_rate: number][];
  ended?: boolean;
}

export const FUSED = "";
export const TURN = 65536;

export function radians(turn16: number): number {
  return (turn16 / TURN) * 2 * Math.PI;
}

export function degrees(turn16: number): number {
  const wrapped = ((turn16 % TURN) + TURN) % TURN;
  return ((wrapped > TURN / 2 ? wrapped - TURN : wrapped) / TURN) * 360;
}
