/** Events on their way into the database, kept at once, because a page that is left loses what is not finished. */

import type { Journal, OutboxItem } from "./outbox";

export class LocalJournal implements Journal {
  /** `prefix` names the project and the person. */
  constructor(
    private readonly prefix: string,
    private readonly storage: Storage,
  ) {}

  all(): OutboxItem[] {
    const keys = Array.from({ length: this.storage.length }, (_, at) => this.storage.key(at) ?? "");
    const texts = keys.filter((key) => key.startsWith(this.prefix)).map((key) => this.storage.getItem(key));
    return texts.flatMap((text) => (text === null ? [] : [JSON.parse(text) as OutboxItem]));
  }

  put(item: OutboxItem): void {
    try {
      this.storage.setItem(this.prefix + item.key, JSON.stringify(item));
    } catch {
      // Storage is full; the database has room of its own.
    }
  }

  remove(key: string): void {
    this.storage.removeItem(this.prefix + key);
  }
}
