// One cursor over all plots over time, and the values under it; the page is complete without this script.
const plots = [...document.querySelectorAll("figure[data-plot]")].map((figure) => ({
  figure,
  svg: figure.querySelector("svg"),
  cursor: figure.querySelector(".cursor"),
  reading: figure.querySelector(".reading"),
  data: JSON.parse(figure.dataset.plot),
}));

function show(frame, own) {
  for (const plot of plots) {
    const { frames, fps, unit, left, right, lines } = plot.data;
    const x = left + ((right - left) * frame) / Math.max(frames - 1, 1);
    plot.cursor.setAttribute("x1", x);
    plot.cursor.setAttribute("x2", x);
    plot.figure.classList.add("pointed");
    const time = plot === own ? `frame ${frame} · ${(frame / fps).toFixed(2)} s · ` : "";
    const few = plot === own || (lines && lines.length < 3);
    const values = few && lines ? lines.map(([label, v]) => `${label} ${v[frame] ?? "–"}`).join(" · ") + ` ${unit}` : "";
    plot.reading.textContent = time + values;
  }
}

function clear() {
  for (const plot of plots) {
    plot.figure.classList.remove("pointed");
    plot.reading.textContent = "";
  }
}

for (const plot of plots) {
  plot.svg.addEventListener("pointermove", (event) => {
    const box = plot.svg.getBoundingClientRect();
    const { frames, left, right } = plot.data;
    const x = ((event.clientX - box.left) / box.width) * plot.svg.viewBox.baseVal.width;
    const frame = Math.round(((x - left) / (right - left)) * (frames - 1));
    show(Math.min(Math.max(frame, 0), frames - 1), plot);
  });
  plot.svg.addEventListener("pointerleave", clear);
}
