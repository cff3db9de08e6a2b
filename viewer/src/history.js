// What has been authored, step by step: an entry is {project, seed}, the seed that of its clip once there is one.
import { checked } from "./project.js";

export const MOST_ENTRIES = 100;

export function createHistory(onchange = () => {}) {
  let entries = [];
  let at = -1;

  const told = (value) => {
    onchange();
    return value;
  };

  return {
    get now() {
      return entries[at] ?? null;
    },
    get canUndo() {
      return at > 0;
    },
    get canRedo() {
      return at < entries.length - 1;
    },
    /** A new step; what had been undone is gone. One that changes nothing is none. */
    push(entry) {
      if (at >= 0 && JSON.stringify(entries[at]) === JSON.stringify(entry)) return;
      entries = [...entries.slice(0, at + 1), entry].slice(-MOST_ENTRIES);
      at = entries.length - 1;
      onchange();
    },
    /** The present step, changed: it is no new one. */
    amend(change) {
      entries = entries.with(at, { ...entries[at], ...change });
      onchange();
    },
    undo() {
      return at > 0 ? told(entries[--at]) : null;
    },
    redo() {
      return at < entries.length - 1 ? told(entries[++at]) : null;
    },
    toJSON: () => ({ entries, at }),
    /** Another history, without the steps that are none; an error leaves this one as it is. */
    load(value) {
      let wrong = null;
      const found = (value?.entries ?? []).slice(-MOST_ENTRIES).flatMap((entry) => {
        try {
          const { project, seed } = entry;
          return [{ project: checked(project), ...(typeof seed === "string" && /^\d{1,19}$/.test(seed) && { seed }) }];
        } catch (error) {
          wrong = error;
          return [];
        }
      });
      if (!found.length) throw wrong ?? new Error("This is no project of kinegraph: nothing is in it.");
      entries = found;
      at = Math.min(Math.max(Number(value.at) || 0, 0), found.length - 1);
      onchange();
    },
  };
}
