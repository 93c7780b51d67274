// SPDX-License-Identifier: GPL-2.0-or-later
// Elements of the page.  Text of packets becomes a text node, never HTML.

// Make an element: properties such as { className, title }; content: texts and elements.
export function make(kind, properties, ...content) {
  const element = Object.assign(document.createElement(kind), properties);
  element.append(...content);
  return element;
}
