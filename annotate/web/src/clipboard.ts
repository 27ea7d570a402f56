/** Copying and saving texts. */

/** Copies a text; false if the browser does not let the page do it. */
export async function copyText(text: string): Promise<boolean> {
  try {
    // `navigator.clipboard` is missing on pages opened over plain HTTP from another host.
    await navigator.clipboard.writeText(text);
    return true;
  } catch {
    const field = document.createElement("textarea");
    field.value = text;
    document.body.append(field);
    field.select();
    const done = document.execCommand("copy");
    field.remove();
    return done;
  }
}

export function saveText(name: string, type: string, text: string): void {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(new Blob([text], { type }));
  link.download = name;
  link.click();
  window.setTimeout(() => URL.revokeObjectURL(link.href));
}
