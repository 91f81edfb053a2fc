/* Tries every control, and lists them. */
(() => {
  document.querySelectorAll("details").forEach((part) => { part.open = true; });
  const tried = [];
  for (const select of document.querySelectorAll("select")) {
    for (const value of [...select.options].filter((option) => !option.disabled).map((option) => option.value).slice(0, 12)) {
      if (![...select.options].some((option) => option.value === value)) continue;
      select.value = value; select.dispatchEvent(new Event("change", { bubbles: true })); tried.push(`${select.id}=${value}`);
    }
  }
  for (const input of document.querySelectorAll("input")) {
    if (input.type === "checkbox") input.click(); else {
      input.value = input.type === "range" ? input.max : "jpeg";
      input.dispatchEvent(new Event("input", { bubbles: true })); input.value = input.type === "range" ? 0 : "";
      input.dispatchEvent(new Event("input", { bubbles: true }));
    }
    tried.push(input.id);
  }
  for (const button of document.querySelectorAll("button")) if (button.isConnected) { button.click(); tried.push(button.id || button.textContent); }
  return tried;
})()
