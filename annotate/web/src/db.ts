/**
 * Storage in the browser (IndexedDB): a database for each project, because another project may be served at the same
 * address later. Edits are stored here before they are sent, and removed once the server has acknowledged them.
 */

const VERSION = 1;
const STORES = ["outbox", "chains"] as const;

export type StoreName = (typeof STORES)[number];

/** Key-value store; tests use one in memory. */
export interface KeyValue {
  all<T>(store: StoreName): Promise<T[]>;
  get<T>(store: StoreName, key: string): Promise<T | undefined>;
  put(store: StoreName, key: string, value: unknown): Promise<void>;
  remove(store: StoreName, key: string): Promise<void>;
}

export class MemoryStore implements KeyValue {
  private readonly texts: Readonly<Record<StoreName, Map<string, string>>> = { outbox: new Map(), chains: new Map() };

  async all<T>(store: StoreName): Promise<T[]> {
    return [...this.texts[store].values()].map((text) => JSON.parse(text) as T);
  }

  async get<T>(store: StoreName, key: string): Promise<T | undefined> {
    const text = this.texts[store].get(key);
    return text === undefined ? undefined : (JSON.parse(text) as T);
  }

  async put(store: StoreName, key: string, value: unknown): Promise<void> {
    this.texts[store].set(key, JSON.stringify(value));
  }

  async remove(store: StoreName, key: string): Promise<void> {
    this.texts[store].delete(key);
  }
}

export class BrowserStore implements KeyValue {
  private constructor(private readonly database: IDBDatabase) {}

  static open(name: string): Promise<BrowserStore> {
    return new Promise((resolve, reject) => {
      const request = indexedDB.open(name, VERSION);
      request.onupgradeneeded = () => {
        for (const name of STORES) {
          if (!request.result.objectStoreNames.contains(name)) request.result.createObjectStore(name);
        }
      };
      request.onsuccess = () => resolve(new BrowserStore(request.result));
      request.onerror = () => reject(request.error ?? new Error("the browser's store cannot be opened"));
    });
  }

  close(): void {
    this.database.close();
  }

  all<T>(store: StoreName): Promise<T[]> {
    return this.run<T[]>(store, "readonly", (objects) => objects.getAll());
  }

  get<T>(store: StoreName, key: string): Promise<T | undefined> {
    return this.run<T | undefined>(store, "readonly", (objects) => objects.get(key));
  }

  async put(store: StoreName, key: string, value: unknown): Promise<void> {
    await this.run(store, "readwrite", (objects) => objects.put(value, key));
  }

  async remove(store: StoreName, key: string): Promise<void> {
    await this.run(store, "readwrite", (objects) => objects.delete(key));
  }

  /** Resolves when the transaction is complete, so that the data is on disk. */
  private run<T>(store: StoreName, mode: IDBTransactionMode, action: (objects: IDBObjectStore) => IDBRequest): Promise<T> {
    return new Promise((resolve, reject) => {
      const options: IDBTransactionOptions = mode === "readwrite" ? { durability: "strict" } : {};
      const transaction = this.database.transaction(store, mode, options);
      const request = action(transaction.objectStore(store));
      transaction.oncomplete = () => resolve(request.result as T);
      transaction.onerror = () => reject(transaction.error ?? new Error("the browser's store failed"));
      transaction.onabort = () => reject(transaction.error ?? new Error("the browser's store is full"));
    });
  }
}
