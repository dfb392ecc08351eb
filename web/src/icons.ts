// The tools' icons, drawn for this page: strokes on a 24 x 24 sheet.

const PATHS: Record<string, string> = {
  "+": "M12 5v14M5 12h14",
  "-": "M5 12h14",
  f: "M4 9V4h5M15 4h5v5M20 15v5h-5M9 20H4v-5",
  t: "M4 18c3 0 3-5 6-5s3 3 6 0 1-7 4-8",
  h: "M6 7h.01M12 5h.01M18 8h.01M8 12h.01M15 12h.01M5 17h.01M11 18h.01M18 17h.01",
  m: "M3 16 16 3l5 5L8 21zM7 12l2 2M10 9l2 2M13 6l2 2",
  play: "M7 4.5v15l12-7.5z",
  pause: "M8 5v14M16 5v14",
  sun: "M12 8a4 4 0 1 0 0 8 4 4 0 0 0 0-8M12 2v2M12 20v2M4.9 4.9l1.4 1.4M17.7 17.7l1.4 1.4M2 12h2M20 12h2M4.9 19.1l1.4-1.4M17.7 6.3l1.4-1.4",
  moon: "M20 14.5A8.5 8.5 0 0 1 9.5 4 8.5 8.5 0 1 0 20 14.5",
};

export function icon(name: string): SVGSVGElement {
  const svg = document.createElementNS("http://www.w3.org/2000/svg", "svg");
  svg.setAttribute("viewBox", "0 0 24 24");
  svg.setAttribute("class", `icon${name === "h" ? " points" : ""}`);
  const path = document.createElementNS("http://www.w3.org/2000/svg", "path");
  path.setAttribute("d", PATHS[name]);
  svg.append(path);
  return svg;
}
