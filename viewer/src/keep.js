// What the browser keeps of a tab: its history, through a reload and for the next visit, and the character.
// The server keeps nothing. Where storage is full or forbidden, work goes on without.
const KEY = "kinegraph";
const MOST = 2_000_000; // characters

/** storages: that of the tab first, then that of all tabs, from which a new tab begins. */
export function createKeep(storages = [() => sessionStorage, () => localStorage]) {
  const each = (act) => {
    for (const storage of storages) {
      try {
        const found = act(storage());
        if (found) return found;
      } catch {
        // full, forbidden, or not ours
      }
    }
    return null;
  };
  return {
    /** Keep the newest steps that there is room for, the present one among them. */
    save(history) {
      let { entries, at } = history.toJSON();
      const written = () => JSON.stringify({ entries, at });
      while (written().length > MOST && entries.length > 1) {
        const [cut, end] = [Math.min(at, Math.ceil(entries.length / 4)), entries.length - 1];
        entries = cut ? entries.slice(cut) : entries.slice(0, Math.ceil(end / 2));
        at -= cut;
      }
      const text = written();
      each((storage) => {
        if (text.length <= MOST) storage.setItem(KEY, text);
      });
    },
    /** Fill a history with what was kept; false if that is nothing. */
    load: (history) =>
      Boolean(
        each((storage) => {
          const text = storage.getItem(KEY);
          if (text) history.load(JSON.parse(text));
          return text;
        }),
      ),
    has: () => Boolean(each((storage) => storage.getItem(KEY))),
    clear() {
      each((storage) => {
        storage.removeItem(KEY);
      });
    },
  };
}

/** One file in the browser's database, which holds more than its storage. */
export const keptFile = {
  save: (file) => within("readwrite", (store) => (file ? store.put(file, KEY) : store.delete(KEY))),
  load: () => within("readonly", (store) => store.get(KEY)),
};

function within(mode, act) {
  return new Promise((resolve) => {
    const nothing = () => resolve(null);
    try {
      const opening = indexedDB.open(KEY, 1);
      opening.onupgradeneeded = () => opening.result.createObjectStore("files");
      opening.onerror = opening.onblocked = nothing;
      opening.onsuccess = () => {
        const asked = act(opening.result.transaction("files", mode).objectStore("files"));
        asked.onsuccess = () => {
          opening.result.close();
          resolve(asked.result ?? null);
        };
        asked.onerror = nothing;
      };
    } catch {
      nothing();
    }
  });
}
