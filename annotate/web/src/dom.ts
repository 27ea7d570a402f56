/** Creates elements in code: data reaches the page as text nodes and attributes of fixed names, never as markup. */

export type Child = Node | string | number | null | undefined | false;

export interface Props {
  class?: string | undefined;
  /** Attributes by name; `true` sets an empty attribute, `false` and `null` omit it. */
  attrs?: Record<string, string | number | boolean | null | undefined>;
  data?: Record<string, string>;
  on?: { [K in keyof HTMLElementEventMap]?: (event: HTMLElementEventMap[K]) => void };
}

/** Attributes that can run code or load resources; data must not set them. */
const FORBIDDEN = /^(on|style$|src$|href$|srcdoc$|formaction$|action$)/i;

export function h<K extends keyof HTMLElementTagNameMap>(tag: K, props: Props = {}, ...children: Child[]): HTMLElementTagNameMap[K] {
  const element = document.createElement(tag);
  // The default type `submit` would send the surrounding form.
  if (tag === "button") element.setAttribute("type", "button");
  if (props.class) element.className = props.class;
  for (const [name, value] of Object.entries(props.attrs ?? {})) {
    setAttr(element, name, value);
  }
  for (const [name, value] of Object.entries(props.data ?? {})) {
    element.dataset[name] = value;
  }
  for (const [name, listener] of Object.entries(props.on ?? {})) {
    element.addEventListener(name, listener as EventListener);
  }
  fill(element, ...children);
  return element;
}

/** Replaces the content of an element. */
export function fill(parent: Element, ...children: Child[]): void {
  const shown = children.filter((child) => child !== null && child !== undefined && child !== false);
  parent.replaceChildren(...shown.map((child) => (child instanceof Node ? child : String(child))));
}

export function setAttr(element: Element, name: string, value: string | number | boolean | null | undefined): void {
  if (FORBIDDEN.test(name)) throw new Error(`attribute ${name} is not set this way`);
  if (value === null || value === undefined || value === false) {
    element.removeAttribute(name);
  } else {
    element.setAttribute(name, value === true ? "" : String(value));
  }
}

export function isTextField(target: EventTarget | null): boolean {
  if (target instanceof HTMLTextAreaElement) return true;
  if (target instanceof HTMLInputElement) {
    return !["checkbox", "radio", "range", "button", "submit"].includes(target.type);
  }
  return target instanceof HTMLElement && target.isContentEditable;
}
