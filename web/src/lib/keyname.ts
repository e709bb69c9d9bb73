/** Return the name of the palette key: Command K on Apple keyboards, otherwise Control K. */
export function goToKey(platform: string): string {
  return /mac|iphone|ipad/i.test(platform) ? '⌘K' : 'Ctrl K';
}
