/** How the keyboard in front of the person names Command or Control with K. */
export function goToKey(platform: string): string {
  return /mac|iphone|ipad/i.test(platform) ? '⌘K' : 'Ctrl K';
}
