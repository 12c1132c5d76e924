// Images to flip between; without this script a page shows the first one.
"use strict";
for (const book of document.querySelectorAll(".flip")) {
  const frame = book.querySelector(".views"), told = frame.querySelector("output");
  const chooser = book.querySelector(".image"), wiper = book.querySelector(".wipe");
  const buttons = [...book.querySelectorAll("[data-choose]")];
  const names = [...book.querySelectorAll(".name")];
  const pictures = new Map(), depths = new Map();
  for (const picture of frame.querySelectorAll("[data-view]"))
    pictures.set(`${picture.dataset.image} ${picture.dataset.view}`, picture);
  for (const picture of frame.querySelectorAll("[data-values]"))
    depths.set(picture.dataset.values, picture);
  const beside = new Image();  // the file of an image that is not within the page
  beside.alt = "This page holds some images only; the others lie in its folder.";
  beside.hidden = true;
  frame.append(beside);
  const count = names.length;
  let view = buttons[0].dataset.choose, shown = beside;

  const show = () => {
    const k = chooser.value, photo = pictures.get(`${k} image`);
    shown = pictures.get(`${k} ${view}`) ?? beside;
    if (shown === beside) beside.src = names[k].dataset.file;
    const left = photo && shown !== photo && wiper ? +wiper.value : 0;
    for (const picture of [...pictures.values(), beside])
      picture.hidden = picture !== shown && !(left && picture === photo);
    shown.style.clipPath = left ? `inset(0 0 0 ${left}%)` : "";
    shown.style.zIndex = 1;
    if (photo && photo !== shown) photo.style.zIndex = 0;
    told.style.zIndex = 2;
    told.hidden = true;
    for (const text of book.querySelectorAll("[data-of]"))
      text.hidden = text.dataset.of !== k && text.dataset.of !== view;
    for (const button of buttons)
      button.setAttribute("aria-pressed", button.dataset.choose === view);
    book.dataset.seconds = names[k].dataset.seconds;
  };
  const flip = () => {
    show();
    const detail = +book.dataset.seconds;
    book.dispatchEvent(new CustomEvent("flip", { detail, bubbles: true }));
  };
  const step = (by) => { chooser.value = (+chooser.value + by + count) % count; flip(); };

  // The depth at a place of the picture, from 0 to 1 in both directions.
  const depthAt = (x, y) => {
    let values = depths.get(chooser.value);
    if (values instanceof Image) {
      const canvas = document.createElement("canvas");
      [canvas.width, canvas.height] = [values.naturalWidth, values.naturalHeight];
      const context = canvas.getContext("2d", { willReadFrequently: true });
      context.drawImage(values, 0, 0);
      values = context.getImageData(0, 0, canvas.width, canvas.height);
      depths.set(chooser.value, values);
    }
    if (!values || !(x >= 0 && x < 1 && y >= 0 && y < 1)) return "";
    const at = 4 * (Math.floor(y * values.height) * values.width + Math.floor(x * values.width));
    const cm = 256 * values.data[at] + values.data[at + 1];
    return cm ? `${(cm / 100).toFixed(2)} m` : "no depth";
  };
  const point = (event) => {
    const box = frame.getBoundingClientRect();
    const x = event.clientX - box.left, y = event.clientY - box.top;
    for (const picture of frame.querySelectorAll("img"))
      picture.style.transformOrigin = `${x}px ${y}px`;
    const [width, height] = [shown.naturalWidth, shown.naturalHeight];
    const scale = Math.min(box.width / width, box.height / height);  // as object-fit: contain
    told.textContent = depthAt((x - (box.width - width * scale) / 2) / (width * scale),
      (y - (box.height - height * scale) / 2) / (height * scale));
    told.hidden = !told.textContent;
  };
  frame.onpointermove = point;
  frame.onpointerleave = () => { told.hidden = true; };
  frame.onclick = (event) => { frame.classList.toggle("large"); point(event); };

  for (const button of buttons) button.onclick = () => { view = button.dataset.choose; flip(); };
  chooser.oninput = flip;
  if (wiper) wiper.oninput = show;
  book.querySelector(".before").onclick = () => step(-1);
  book.querySelector(".after").onclick = () => step(1);
  book.tabIndex = 0;
  book.onkeydown = (event) => {
    if (event.target.type === "range" || event.altKey || event.ctrlKey || event.metaKey) return;
    if (event.key === "ArrowLeft") step(-1);
    else if (event.key === "ArrowRight") step(1);
    else if (buttons[+event.key - 1]) buttons[+event.key - 1].click();
    else return;
    event.preventDefault();
  };
  show();
}
// While nothing has the focus, keys are for the first book.
document.addEventListener("keydown", (event) => {
  if (event.target === document.body) document.querySelector(".flip")?.onkeydown(event);
});
