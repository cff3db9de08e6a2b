// What is dragged, while it is: drafts of the newest place, one after another; the clip where the pointer rests.
const REST = 350; // milliseconds after the draft of the newest place was drawn

/**
 * @param on {draft(project) resolves when it is drawn, make(project)}
 * @param clock {set, clear} of timers
 */
export function createDragging(on, clock = { set: (act, ms) => setTimeout(act, ms), clear: (id) => clearTimeout(id) }) {
  let wanted = null; // newest place, not yet drafted
  let newest = null; // newest place, while something is held
  let drafting = false;
  let timer = null;

  async function draft() {
    if (drafting) return;
    drafting = true;
    while (wanted) {
      const now = wanted;
      wanted = null;
      await on.draft(now);
    }
    drafting = false;
    const rests = newest;
    if (rests) timer = clock.set(() => on.make(rests), REST);
  }

  return {
    /** Another place; places that are overtaken are left out. */
    to(project) {
      wanted = newest = project;
      clock.clear(timer);
      return draft();
    },
    /** It was let go. */
    end() {
      wanted = newest = null;
      clock.clear(timer);
    },
  };
}
