// How concepts are mixed: the joint sentence and the shares of "fused", and adaptive gradient descent.
import { element } from "./elements.js";

const SHARES = [
  ["latent", "Each concept predicts by itself, and predictions add up (EnergyMoGen, Eq. 7)"],
  ["semantic", "What concepts attend to is averaged (Eq. 9)"],
  ["joint sentence", "One sentence for all of them"],
];
const STEP = 0.05;
const AGD = "0.2"; // what the default bundle does best with, for both step sizes

/** Shares that sum to 1, one of them set; the others keep their proportion of what is left. All on the grid of STEP. */
export function shared(shares, which, value) {
  const grid = Math.round(1 / STEP);
  const set = Math.round(value * grid);
  const [one, other] = [0, 1, 2].filter((at) => at !== which);
  const rest = shares[one] + shares[other];
  const found = [0, 0, 0];
  found[which] = set;
  found[one] = Math.round((grid - set) * (rest ? shares[one] / rest : 0.5));
  found[other] = grid - set - found[one];
  return found.map((share) => share / grid);
}

/** facts: {lambdas, agd} of the bundle; method() tells the present one. */
export function createMixing(box, facts, method, onchange) {
  const [fused, rows, adapt] = [".fused", ".shares", ".adapt"].map((name) => box.querySelector(name));
  const [joint, agd, ...sizes] = ["joint", "agd", "gamma_attn", "gamma_reg"].map((name) => box.querySelector(`[name=${name}]`));
  const mayFuse = () => ["auto", "fused"].includes(method()); // who sets shares is not made by parts
  let shares = facts.lambdas; // as they are drawn
  let settled = shares; // as they were before the slider that moves was touched

  const sliders = SHARES.map(([name, title], which) => {
    const slider = element("input", { type: "range", min: 0, max: 1, step: STEP, "aria-label": `Share of ${name}` });
    const out = element("output", {});
    slider.addEventListener("input", () => draw(shared(settled, which, slider.valueAsNumber)));
    slider.addEventListener("change", () => {
      settled = shares;
      onchange();
    });
    rows.append(element("label", { title }, element("span", {}, name), slider, out));
    return { slider, out };
  });

  function draw(now) {
    shares = now;
    sliders.forEach(({ slider, out }, at) => {
      slider.value = shares[at];
      out.textContent = `${Math.round(100 * shares[at])} %`;
    });
  }

  function look() {
    fused.hidden = !mayFuse();
    box.querySelector(".sizes").hidden = !agd.checked;
  }

  adapt.hidden = !facts.agd;
  for (const field of [joint, agd, ...sizes]) {
    field.addEventListener("change", () => {
      look();
      onchange();
    });
  }

  return {
    look,
    /** What differs from the bundle's own. */
    get() {
      const asked = {};
      if (mayFuse()) {
        if (joint.value.trim()) asked.text = joint.value.trim();
        if (shares.some((share, at) => share !== facts.lambdas[at])) asked.lambdas = shares.join();
      }
      if (agd.checked) asked.agd = sizes.map((size) => size.value.trim()).join();
      return asked;
    },
    set({ text, lambdas, agd: gammas }) {
      joint.value = text ?? "";
      draw((settled = lambdas ? String(lambdas).split(",").map(Number) : facts.lambdas));
      agd.checked = gammas !== undefined;
      const given = gammas === undefined ? [] : String(gammas).split(",");
      sizes.forEach((size, at) => (size.value = given[at] ?? AGD));
      box.open = [text, lambdas, gammas].some((value) => value !== undefined);
      look();
    },
  };
}
