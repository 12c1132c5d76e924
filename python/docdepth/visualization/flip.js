// Images to flip between; without this script a page shows the first one.
"use strict";
for (const book of document.querySelectorAll(".flip")) {
  const chooser = book.querySelector("input");
  const buttons = [...book.querySelectorAll("[data-choose]")];
  const count = +chooser.max + 1;
  let view = buttons[0].dataset.choose;
  const choose = () => {
    for (const picture of book.querySelectorAll(".views img"))
      picture.hidden = picture.dataset.image !== chooser.value || picture.dataset.view !== view;
    for (const text of book.querySelectorAll("[data-of]"))
      text.hidden = text.dataset.of !== chooser.value && text.dataset.of !== view;
    for (const button of buttons)
      button.setAttribute("aria-pressed", button.dataset.choose === view);
    const chosen = book.querySelector(`.name[data-of="${chooser.value}"]`);
    return +chosen.dataset.seconds;
  };
  const show = () => {
    book.dispatchEvent(new CustomEvent("flip", { detail: choose(), bubbles: true }));
  };
  const step = (by) => { chooser.value = (+chooser.value + by + count) % count; show(); };
  for (const button of buttons) button.onclick = () => { view = button.dataset.choose; show(); };
  chooser.oninput = show;
  book.querySelector(".before").onclick = () => step(-1);
  book.querySelector(".after").onclick = () => step(1);
  book.tabIndex = 0;
  book.onkeydown = (event) => {
    if (event.target === chooser) return;
    if (event.key === "ArrowLeft") step(-1);
    else if (event.key === "ArrowRight") step(1);
    else if (buttons[+event.key - 1]) buttons[+event.key - 1].click();
    else return;
    event.preventDefault();
  };
  book.dataset.seconds = choose();
}
